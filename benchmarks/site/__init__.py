"""The documentation site: what is generated when MkDocs builds it (``mkdocs.yml``)."""
