defmodule Situ.Studio.Members do
  @moduledoc """
  Lists the members of a stream's values as expressions, so that each can become a derived stream: fields of structs,
  keys of maps, and indexes of tuples and short lists. Pure.

      iex> Situ.Studio.Members.expressions("Robot.Pose", [%{:x => 1, "left hand" => 2}, {1, 2}])
      ["`Robot.Pose`.x", "`Robot.Pose`['left hand']", "`Robot.Pose`[0]", "`Robot.Pose`[1]"]
      iex> Situ.Studio.Members.expressions("= `A` + 1", [%{7 => true}])
      ["(`A` + 1)[7]"]
      iex> Situ.Studio.Members.expressions("Level", [0.5])
      []
  """

  # Longer lists are treated as numeric data, which bar charts show.
  @longest 16

  @doc "Returns an expression for each member that occurs in any of the values, sorted by name."
  @spec expressions(String.t(), [term()]) :: [String.t()]
  def expressions(stream, values) do
    base = base(stream)
    values |> Enum.flat_map(&members/1) |> Enum.uniq() |> Enum.sort() |> Enum.map(&(base <> &1))
  end

  defp base("= " <> text), do: if(text =~ ~r/\A`[^`]*`[\w.]*\z/u, do: text, else: "(#{text})")
  defp base(stream), do: "`#{String.replace(stream, "`", "``")}`"

  defp members(%_{} = struct), do: struct |> Map.from_struct() |> members()
  defp members(%{} = map), do: for(key <- Map.keys(map), text = member(key), do: text)
  defp members(tuple) when is_tuple(tuple), do: tuple |> Tuple.to_list() |> places()
  defp members([_ | _] = list), do: if(List.improper?(list), do: [], else: places(list))
  defp members(_), do: []

  defp places(list) do
    if Enum.drop(list, @longest) == [],
      do: for(i <- 0..(length(list) - 1)//1, do: "[#{i}]"),
      else: []
  end

  defp member(key) when is_integer(key), do: "[#{key}]"
  defp member(key) when is_atom(key), do: key |> Atom.to_string() |> member()

  defp member(key) when is_binary(key) do
    cond do
      not String.valid?(key) -> nil
      key =~ ~r/\A[A-Za-z_][A-Za-z0-9_]*\z/ -> "." <> key
      true -> "['#{String.replace(key, "'", "''")}']"
    end
  end

  defp member(_), do: nil
end
