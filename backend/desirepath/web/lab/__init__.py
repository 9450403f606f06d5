"""The experimenters' pages: studies, people, protocols, reports, settings."""
