"""Files, texts, checks, calls and numerical methods that know no robot."""
