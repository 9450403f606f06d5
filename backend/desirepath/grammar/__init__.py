"""What people write files with: strict models, YAML with lines, questionnaires, skip logic; no stage, no table."""
