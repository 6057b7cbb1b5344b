defmodule Situ.BinarySize do
  @moduledoc false
  # Writes sizes in binary patterns for every supported version of Elixir.

  @doc """
  Expands to the size of a binary segment. Its variables must be bound before the match.

  When the size in a pattern is a variable bound outside the pattern, Elixir before 1.20 expects `size(n)` and later
  versions expect `size(^n)`. The macro `pinned_size/1` expands to the right form:

      iex> import Situ.BinarySize, only: [pinned_size: 1]
      iex> n = 2
      iex> <<head::binary-pinned_size(n), rest::binary>> = "abcde"
      iex> {head, rest}
      {"ab", "cde"}
  """
  defmacro pinned_size(size)

  if Version.match?(System.version(), ">= 1.20.0") do
    defmacro pinned_size(size), do: {:size, [], [Macro.postwalk(size, &pin/1)]}

    defp pin({name, _, context} = variable) when is_atom(name) and is_atom(context),
      do: {:^, [], [variable]}

    defp pin(other), do: other
  else
    defmacro pinned_size(size), do: {:size, [], [size]}
  end
end
