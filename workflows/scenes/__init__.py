"""A scene from a file: body, tissues, supports, loads, and how it is solved."""
