"""The packaged assets and files of arrays, read and written."""
