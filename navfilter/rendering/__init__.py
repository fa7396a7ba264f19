"""Parts of HTML pages and figures that identification, evaluation and report share."""
