"""The result of a diagnosis as data, and what is made of it: sentences, pictures, page, the next experiment."""
