defmodule Situ.Bits do
  @moduledoc """
  Sizes in binary patterns for all versions of Elixir.

  A pattern whose size is a variable from outside of it is written `size(n)` before Elixir 1.20, and `size(^n)` from
  then on. `known/1` is either:

      iex> import Situ.Bits, only: [known: 1]
      iex> n = 2
      iex> <<head::binary-known(n), rest::binary>> = "abcde"
      iex> {head, rest}
      {"ab", "cde"}
  """

  @doc "The size of a segment, from variables that have their values before the match."
  defmacro known(size)

  if Version.match?(System.version(), ">= 1.20.0") do
    defmacro known(size), do: {:size, [], [Macro.postwalk(size, &pin/1)]}

    defp pin({name, _, context} = variable) when is_atom(name) and is_atom(context),
      do: {:^, [], [variable]}

    defp pin(other), do: other
  else
    defmacro known(size), do: {:size, [], [size]}
  end
end
