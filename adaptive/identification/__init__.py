"""Identification: the structure and its loads, what a record allows, and the settings that follow; its fit is fit/."""
