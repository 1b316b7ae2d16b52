"""Files of measured reflectance, one module a format; :mod:`.reader` tells them apart by content."""

from brdfatlas.formats.reader import FORMATS, check, format_of, read

__all__ = ["FORMATS", "check", "format_of", "read"]
