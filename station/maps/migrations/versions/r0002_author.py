"""Which station wrote a version: several share one database."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("map_version", sa.Column("author", sa.String(200), nullable=False, server_default=""))
