"""The routes that participants reach: joining, a session's pages and answers, trials, drawing, the stream."""
