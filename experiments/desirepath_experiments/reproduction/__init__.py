"""One command per published chapter: compute its tables and figures anew, and set them beside what was published."""
