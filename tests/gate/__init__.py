"""Engines written by a hand that does not know how verdicts are reached: twenty right and thirty wrong ones."""
