"""One file per question: work and precision, drift, stability."""
