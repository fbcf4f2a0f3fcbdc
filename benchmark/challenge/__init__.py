"""The sealed challenge: recordings with something concealed are answered before anybody looks, then opened and scored."""
