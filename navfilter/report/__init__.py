"""What a run shows people: figures and the page that holds them."""
