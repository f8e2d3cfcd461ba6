"""What people have as footage: which files, how masks are meant, when frames were taken, where a video is cut."""
