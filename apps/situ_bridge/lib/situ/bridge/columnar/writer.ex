defmodule Situ.Bridge.Columnar.Writer do
  @moduledoc false
  # The behaviour of a writer of columnar files. Errors: `:io`, `:disk_full`.
  alias Situ.Bridge.Columnar.Column
  alias Situ.Error

  @type t :: %{required(:rows) => non_neg_integer(), optional(atom()) => term()}

  @doc "Creates a file. Takes the options `compression:` and `rows:`, the maximum number of rows in a group."
  @callback create(Path.t(), [Column.t()], keyword()) :: {:ok, t()} | {:error, Error.t()}
  @doc "Returns how many rows `write/3` takes at once, if a group has at most `rows` rows."
  @callback max_rows(rows :: pos_integer()) :: pos_integer()
  @doc "Writes some rows, given as rows, each a list of values, or as the values of each column."
  @callback write(t(), {:rows, [[term()]]} | [Column.values()], rows :: pos_integer()) ::
              {:ok, t()} | {:error, Error.t()}
  @doc "Writes the end of the file and renames it to its final name."
  @callback finish(t()) :: {:ok, rows :: non_neg_integer()} | {:error, Error.t()}
  @doc "Deletes the unfinished file."
  @callback abandon(t()) :: :ok
end
