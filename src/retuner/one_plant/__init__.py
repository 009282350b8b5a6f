"""Loops on one plant, retuned together: what the others do is no verdict on a loop, and no change is made that they do
not survive.
"""
