"""Fetches a page of a server and looks for a text in it: fetch.py URL TEXT."""

import sys
import urllib.request

url, expected = sys.argv[1:]
with urllib.request.urlopen(url, timeout=60) as answer:
    page = answer.read().decode()
if expected not in page:
    sys.exit(f"{url}: found {page[:300]!r}, expected {expected!r} in it")
