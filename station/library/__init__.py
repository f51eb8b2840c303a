"""What the station keeps: navigations, maps, comparisons."""
