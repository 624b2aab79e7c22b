"""What tables are made of: the metadata, and kinds of columns that both databases keep alike."""

from collections.abc import Callable

from sqlalchemy import JSON, BigInteger, Column, Double, ForeignKey, Integer, MetaData, String
from sqlalchemy.types import TypeEngine, UserDefinedType


class ExactFloat(UserDefinedType[float]):
    """A 64-bit float that SQLite stores untouched.

    A column declared as a floating type has REAL affinity, under which SQLite turns -0.0 into 0.0;
    one declared BLOB has none, and every bit that went in comes out.
    """

    cache_ok = True

    def get_col_spec(self, **_: object) -> str:
        """Return the declared type."""
        return "BLOB"

    def bind_processor(self, dialect: object) -> Callable[[float | None], float | None]:
        """Return a function that makes floats of integers and NumPy scalars."""
        _ = dialect
        return lambda value: None if value is None else float(value)


METADATA = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
        "pk": "pk_%(table_name)s",
    }
)

# SQLite numbers rows by itself only in a column declared INTEGER; there that is 64 bits wide too.
ROW_ID = BigInteger().with_variant(Integer(), "sqlite")
EXACT_FLOAT: TypeEngine[float] = Double().with_variant(ExactFloat(), "sqlite")
# Absent JSON is SQL NULL, never the JSON text "null".
JSON_OR_NULL = JSON(none_as_null=True)


def site_id_column(*, nullable: bool = False, index: bool = True) -> Column[str]:
    """Return the column that says whose site a row is."""
    return Column(
        "site_id",
        String,
        ForeignKey("sites.id", ondelete="SET NULL" if nullable else "CASCADE"),
        nullable=nullable,
        index=index,
    )


def row_version_column() -> Column[int]:
    """Return the column that counts the edits of a row: its ETag."""
    return Column("row_version", Integer, nullable=False, server_default="1")
