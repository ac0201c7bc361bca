"""Exam 001: unlisted effects and plans that are met at first sight."""
