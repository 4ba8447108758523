"""Gowns: cloth that is held, falls on limbs and is pulled up an arm."""
