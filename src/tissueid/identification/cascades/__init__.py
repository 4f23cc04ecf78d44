"""Cascades of linear and static blocks in any order."""
