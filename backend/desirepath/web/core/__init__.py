"""What every route shares: who may, how much, which words, the frame of a page. No page of its own but signing in."""
