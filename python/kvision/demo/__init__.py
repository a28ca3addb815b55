"""`python -m kvision.demo [IMAGE ...]`: photographs filtered, timed and laid out in a gallery. Nothing imports this.

A sheet of the gallery is a `Sheet` (sheet.py) in a file of its own, named in SHEETS (__main__.py).
"""
