"""Task embeddings as an interface to behaviour: blended, searched, mapped, and what each of them does."""
