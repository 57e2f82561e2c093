"""Present the result of a diagnosis as data, sentences, pictures and a page, and propose the next experiment."""
