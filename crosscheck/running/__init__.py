"""Running one scene on one engine, and where a result comes from."""
