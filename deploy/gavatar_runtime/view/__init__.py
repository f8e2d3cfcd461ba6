"""The viewer: a server on this machine that draws, and a page that shows and steers it."""
