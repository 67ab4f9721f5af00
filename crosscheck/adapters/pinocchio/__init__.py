"""Pinocchio: adapter, models, dynamics of trees and of closed loops."""
