"""Files of others, changed by recipes and read in a child of bounded time and memory.

A kind of file is one module with an object `KIND` of the protocol `engine.Kind`, and its row in
`all_kinds.KINDS`.
"""
