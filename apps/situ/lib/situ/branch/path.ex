defmodule Situ.Branch.Path do
  @moduledoc false
  # The name of a branch. It is only built for errors, because branches are many and errors are rare.

  @type t :: String.t() | {String.t(), term()}

  @spec to_string(t()) :: String.t()
  def to_string({path, key}), do: "#{path}[#{inspect(key, limit: 5, printable_limit: 40)}]"
  def to_string(path), do: path
end
