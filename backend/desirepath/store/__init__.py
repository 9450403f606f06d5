"""What is kept: tables, migrations, artefacts, snapshots, data sets out and in, erasure, who counts.

Decides nothing about how a study runs and trains nothing; it knows no web.
"""
