"""One command per published chapter: reproduce its tables and figures, and set them beside what was published."""
