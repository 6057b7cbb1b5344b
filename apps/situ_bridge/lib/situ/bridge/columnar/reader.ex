defmodule Situ.Bridge.Columnar.Reader do
  @moduledoc false
  # A file of columns that is read, a group of rows at a time.
  alias Situ.Error

  @type column :: %{required(:name) => String.t(), optional(atom()) => term()}
  @typedoc "`columns` are those that can be read, `times` the names of those that hold times."
  @type t :: %{
          required(:path) => Path.t(),
          required(:columns) => [column()],
          required(:times) => [String.t()],
          required(:groups) => [term()],
          optional(atom()) => term()
        }

  @callback open(Path.t()) :: {:ok, t()} | {:error, Error.t()}
  @doc "The rows of one group, as lists of their columns' values."
  @callback rows(t(), group :: term(), [column()]) :: {:ok, [[term()]]} | {:error, Error.t()}
end
