defmodule Situ.Bridge.Columnar.Reader do
  @moduledoc false
  # The behaviour of a reader of columnar files: opens a file, and streams the rows of its groups.
  # See docs/adr/0200-parquet-files-are-read-by-a-program.md.
  alias Situ.Error

  @type column :: %{required(:name) => String.t(), optional(atom()) => term()}
  @typedoc """
  `columns` are the readable columns, `left_out` the names and types of the other columns, and `times` the names of
  the columns that hold times.
  """
  @type t :: %{
          required(:path) => Path.t(),
          required(:columns) => [column()],
          required(:times) => [String.t()],
          required(:groups) => [term()],
          required(:left_out) => [{name :: String.t(), type :: String.t()}],
          optional(atom()) => term()
        }

  @callback open(Path.t()) :: {:ok, t()} | {:error, Error.t()}
  @doc """
  Returns the groups that may have rows between two times (`nil` for unlimited) of a column. A format without ranges of
  its groups returns all of them.
  """
  @callback select_groups(t(), column(), {from :: integer() | nil, to :: integer() | nil}) :: [
              term()
            ]
  @doc """
  Returns the rows of some groups as a lazy enumerable; a row is the list of its columns' values. Memory holds only a
  few rows at a time. Raises `Situ.Error`.
  """
  @callback stream_rows(t(), groups :: [term()], [column()]) :: Enumerable.t()
end
