defmodule Situ.Store.TypeNameTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Store.TypeName

  doctest Situ.Store.TypeName

  @simple [:any, :integer, :float, :boolean, :string, :atom, :map, Situ.Message]

  # Converts random numbers to a type.
  defp type([]), do: :any
  defp type([n | rest]) when rem(n, 6) == 1, do: {:list, type(rest)}
  defp type([n | rest]) when rem(n, 6) == 2, do: {:optional, type(rest)}
  defp type([n | rest]) when rem(n, 6) == 3, do: {:tuple, [type(rest), type([])]}
  defp type([n | rest]) when rem(n, 6) == 4, do: {:map, :string, type(rest)}
  defp type([n | _]), do: Enum.at(@simple, rem(n, length(@simple)))

  property "every type round-trips" do
    forall numbers <- list(non_neg_integer()) do
      type = type(numbers)
      TypeName.parse_type(TypeName.format_type(type)) == {:ok, type}
    end
  end

  property "any text is read or refused" do
    forall text <- binary() do
      result = TypeName.parse_type(text)
      match?({:ok, _}, result) or result == :error
    end
  end

  test "no spelling of a name creates an atom" do
    for {spelling, n} <-
          Enum.with_index(~w|:N :"N" N [N:1] 'N' %{N:1} @N N() A.N() ~s(x)N &N/1 {:list,:N}|) do
      name = "never#{System.unique_integer([:positive])}heard#{n}"
      _ = TypeName.parse_type(String.replace(spelling, "N", name))
      assert_raise ArgumentError, fn -> String.to_existing_atom(name) end
    end
  end
end
