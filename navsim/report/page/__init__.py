"""The page of `navsim report`: results as one self-contained file of HTML. Bokeh is imported in this package alone."""
