"""Engines of the tests: two steppers, right ones made of them, tables of mistakes, and engines that break down."""
