defmodule Situ.Studio.Stores do
  @moduledoc false
  # Which recordings lie at or below a path, by name; the name is what stands in an address.

  alias Situ.Studio.NaturalOrder

  @most 5_000

  @spec discover(Path.t() | nil) :: [{String.t(), Path.t()}]
  def discover(nil), do: []

  def discover(path) do
    root = Path.expand(path)

    cond do
      Situ.Store.exists?(root) or File.regular?(root) -> [{Path.basename(root), root}]
      File.dir?(root) -> below(root)
      true -> []
    end
  end

  defp below(root) do
    stores = Situ.Store.list(root, recursive: true)
    endings = Situ.Store.Formats.all() |> Enum.flat_map(& &1.extensions()) |> Enum.join(",")

    files =
      root |> Path.join("**/*{#{endings}}") |> Path.wildcard() |> Enum.filter(&File.regular?/1)

    (stores ++ files)
    |> Enum.take(@most)
    |> Enum.map(&{Path.relative_to(&1, root), &1})
    |> Enum.sort_by(fn {name, _} -> NaturalOrder.key(name) end)
  end
end
