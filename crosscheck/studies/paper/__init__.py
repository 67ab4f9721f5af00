"""Figures and tables of the papers for any scene: vector graphics, LaTeX, BibTeX and data in one folder."""
