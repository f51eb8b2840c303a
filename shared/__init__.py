"""The language robot and station share: messages, framing, session rules, clocks, geometry. Imports nothing of ours."""
