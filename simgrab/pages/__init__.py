"""Tables, figures and HTML pages: templates shared by every report."""
