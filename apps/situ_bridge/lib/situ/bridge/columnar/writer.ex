defmodule Situ.Bridge.Columnar.Writer do
  @moduledoc false
  # The behaviour of a writer of columnar files. Errors: `:io`, `:disk_full`.
  alias Situ.Bridge.Columnar.Column
  alias Situ.Error

  @type t :: %{required(:rows) => non_neg_integer(), optional(atom()) => term()}

  @callback create(Path.t(), [Column.t()], compression :: atom()) ::
              {:ok, t()} | {:error, Error.t()}
  @doc "Writes a group of rows, given as the values of each column."
  @callback write(t(), [Column.values()], rows :: pos_integer()) ::
              {:ok, t()} | {:error, Error.t()}
  @doc "Writes the end of the file and renames it to its final name."
  @callback finish(t()) :: {:ok, rows :: non_neg_integer()} | {:error, Error.t()}
  @doc "Deletes the unfinished file."
  @callback abandon(t()) :: :ok
end
