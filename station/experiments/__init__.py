"""Pairs of navigations, matched, judged and shown: the thesis' chapter 5 and appendix A."""
