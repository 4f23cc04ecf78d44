"""The engines, one file each. A file registers its engine with :func:`tissueid.identification.engine`."""
