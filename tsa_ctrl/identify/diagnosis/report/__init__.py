"""The result of a diagnosis as data, sentences, pictures and a page, and the proposal for the next experiment."""
