defmodule Situ.Bridge.Columnar.Reader do
  @moduledoc false
  # A file of columns that is read: its columns, and the rows of each of its groups.
  alias Situ.Error

  @type column :: %{required(:name) => String.t(), optional(atom()) => term()}
  @typedoc """
  `columns` are those that can be read, `left_out` the names and types of the others, `times` the names of those that
  hold times.
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
  The rows of one group as a lazy enumerable of lists of their columns' values; memory is that of a few rows. Raises
  `Situ.Error`.
  """
  @callback stream_rows(t(), group :: term(), [column()]) :: Enumerable.t()
end
