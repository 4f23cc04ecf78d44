"""The laboratory of TissueID: programs that test the product and its devices, built on its Python interface.

``thesis`` reproduces the figures and tables of the thesis and the benchmarks of the field, ``blind_check`` scores the
diagnosis on sealed scenarios, and ``conformance`` tests a device against the protocol. The product imports nothing from
here: ``commands`` adds the commands by the entry point ``tissueid.commands``.
"""
