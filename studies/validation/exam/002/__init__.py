"""Exam 002: further unlisted effects and plans that are met at first sight."""
