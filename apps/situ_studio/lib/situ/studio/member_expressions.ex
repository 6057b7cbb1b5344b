defmodule Situ.Studio.MemberExpressions do
  @moduledoc false
  # Lists the members of a stream's values as expressions, so that each can become a derived
  # stream: fields of structs, keys of maps, and indexes of tuples and short lists. Pure.

  # Longer lists are treated as numeric data, which bar charts show.
  @longest 16

  @doc """
  Returns an expression for each member that occurs in any of the values, sorted by name.

      iex> Situ.Studio.MemberExpressions.member_expressions("Robot.Pose", [%{:x => 1, "left hand" => 2}, {1, 2}])
      ["`Robot.Pose`.x", "`Robot.Pose`['left hand']", "`Robot.Pose`[0]", "`Robot.Pose`[1]"]
      iex> Situ.Studio.MemberExpressions.member_expressions("= `A` + 1", [%{7 => true}])
      ["(`A` + 1)[7]"]
      iex> Situ.Studio.MemberExpressions.member_expressions("Level", [0.5])
      []
  """
  @spec member_expressions(String.t(), [term()]) :: [String.t()]
  def member_expressions(stream, values) do
    base = base_expression(stream)

    values
    |> Enum.flat_map(&member_suffixes/1)
    |> Enum.uniq()
    |> Enum.sort()
    |> Enum.map(&(base <> &1))
  end

  defp base_expression("= " <> text),
    do: if(text =~ ~r/\A`[^`]*`[\w.]*\z/u, do: text, else: "(#{text})")

  defp base_expression(stream), do: "`#{String.replace(stream, "`", "``")}`"

  defp member_suffixes(%_{} = struct), do: struct |> Map.from_struct() |> member_suffixes()

  defp member_suffixes(%{} = map),
    do: for(key <- Map.keys(map), text = member_suffix(key), do: text)

  defp member_suffixes(tuple) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> index_suffixes()

  defp member_suffixes([_ | _] = list),
    do: if(List.improper?(list), do: [], else: index_suffixes(list))

  defp member_suffixes(_), do: []

  defp index_suffixes(list) do
    if Enum.drop(list, @longest) == [],
      do: for(i <- 0..(length(list) - 1)//1, do: "[#{i}]"),
      else: []
  end

  defp member_suffix(key) when is_integer(key), do: "[#{key}]"
  defp member_suffix(key) when is_atom(key), do: key |> Atom.to_string() |> member_suffix()

  defp member_suffix(key) when is_binary(key) do
    cond do
      not String.valid?(key) -> nil
      key =~ ~r/\A[A-Za-z_][A-Za-z0-9_]*\z/ -> "." <> key
      true -> "['#{String.replace(key, "'", "''")}']"
    end
  end

  defp member_suffix(_), do: nil
end
