"""Maps: places, graph, cloud and appearance of one home, versioned, and where they are kept."""
