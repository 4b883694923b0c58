"""Results on their way to the client: files, archives, exports, pictures of keyframes, comparisons."""
