"""Sources of small plugins, for tests that install them."""

GOOD = """
    from gavatar.registry import DECODERS

    @DECODERS.register("fine")
    def fine(options): ...
"""
