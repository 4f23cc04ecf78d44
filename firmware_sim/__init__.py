"""The other end of the cable."""
