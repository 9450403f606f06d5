"""What protocol files are written with: strict models, YAML with lines, questionnaires, skip logic; knows no stage."""
