"""Mutation testing of the modules that the guarantee rests on.

Every sign, comparison, minimum and truth value in them is flipped, one at a time, in a copy of the
tree; a flip that no test notices is a survivor.
"""
