"""How far apart two motions are, and where answers at several steps go: pure functions of arrays."""
