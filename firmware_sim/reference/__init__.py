"""Reference firmware in C99 (``core`` and ``boards``), and what builds it and compares it with the Python firmware."""
