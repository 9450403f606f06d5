"""A simulated participant at the pages themselves: a real Chromium, its mouse and keys.

Playwright and Chromium belong to the tests' equipment and are asked for only here.
"""
