"""Continuation: points, events, the ledger, branches and their solutions."""
