"""`python -m kvision.demo [IMAGE ...]`: filter photographs, time the operators, and lay the results out in a gallery.

No other module of kvision imports this package; the examples read their command lines by arguments.py and
end their worker processes by workers.py. A sheet of the gallery
is a `Sheet` (sheet.py) in a file of its own, named in SHEETS (__main__.py). `python -m kvision.demo.contact_sheet FILE`
writes the picture of README.md.
"""
