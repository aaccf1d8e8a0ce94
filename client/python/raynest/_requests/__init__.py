"""Requests: arguments become messages, and answers become arrays."""
