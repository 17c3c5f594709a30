"""One self-contained page of HTML: pictures inside, a 3D view without a library, no other host."""

from dress_jax.io.page.document import Page as Page
from dress_jax.io.page.document import picture as picture
from dress_jax.io.page.document import picture_of_file as picture_of_file
from dress_jax.io.page.document import text as text
from dress_jax.io.page.document import write_document as write_document
from dress_jax.io.page.scene import ViewedMesh as ViewedMesh
from dress_jax.io.page.scene import viewer as viewer
