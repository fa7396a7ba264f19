"""The online ARMA estimator: recursive prediction error on a sliding window, a bank of orders, and the front end."""
