defmodule Situ.Studio.Layout.Json do
  @moduledoc false
  # Converts layouts to and from JSON text, for files and addresses. The text is untrusted. Version 1 had rows of panels
  # instead of a tree; it is read, too.
  alias Situ.Error
  alias Situ.Studio.{Layout, Int64}
  alias Situ.Studio.Layout.{Panel, Places, Tree, TreeJson, Visualization}

  @version 2
  @heights 28..2_000
  @id ~r/\A[a-z0-9]{1,16}\z/
  @max_panels elem(Layout.size_limits(), 0)
  @max_vis elem(Layout.size_limits(), 1)

  @spec to_json(Layout.t()) :: String.t()
  def to_json(%Layout{} = layout) do
    doc = %{
      "version" => @version,
      "name" => layout.name,
      "panels" => Enum.map(layout.panels, &panel_json/1)
    }

    doc = put_present(doc, "tree", TreeJson.encode(layout.tree))
    doc |> put_present("compared", compared_json(layout.compared)) |> Situ.JSON.encode_pretty()
  end

  # The offset is a string, because other programs do not keep integers of this size exact.
  defp compared_json({id, offset}), do: %{"with" => id, "offset" => Integer.to_string(offset)}
  defp compared_json(nil), do: nil

  defp panel_json(%Panel{} = p) do
    vis =
      for v <- p.vis,
          do: %{"viz" => v.viz, "stream" => v.stream, "path" => v.path, "props" => v.props}

    %{"id" => p.id, "panel" => Atom.to_string(p.panel), "vis" => vis}
    |> put_present("aspect", p.aspect)
    |> put_present("axis", axis_json(p.axis))
    |> put_present("threshold", p.threshold && Tuple.to_list(p.threshold))
  end

  defp axis_json({min, max}), do: [min, max]
  defp axis_json(:own), do: "own"
  defp axis_json(nil), do: nil

  defp put_present(map, _, nil), do: map
  defp put_present(map, key, value), do: Map.put(map, key, value)

  @spec parse_json(binary()) :: {:ok, Layout.t()} | {:error, Error.t()}
  def parse_json(json) do
    case Situ.JSON.decode(json) do
      {:ok, %{"version" => version, "name" => name, "panels" => panels} = doc}
      when version in 1..@version and is_binary(name) and is_list(panels) and
             length(panels) <= @max_panels ->
        with {:ok, layout} <- read_panels(name, panels),
             {:ok, tree} <- read_tree(layout, doc),
             do:
               {:ok, Layout.put_tree(%{layout | compared: parse_compared(doc["compared"])}, tree)}

      {:ok, %{"version" => version}} when version not in 1..@version ->
        layout_error(
          "it has version #{inspect(version)}, but this studio reads up to #{@version}"
        )

      {:ok, _} ->
        layout_error("it must contain \"version\", \"name\" and \"panels\"")

      {:error, :bad_json} ->
        layout_error("it is not JSON")
    end
  end

  # Several people may have changed the layout at the same time, so the tree may lack panels or have others.
  defp read_tree(layout, %{"version" => 1} = doc) do
    panels = Enum.zip(layout.panels, doc["panels"])
    rows = for row <- Enum.chunk_by(panels, &row_of/1), do: Enum.map(row, fn {p, _} -> p.id end)
    tree = Places.from_rows(rows, Layout.timeline_ids(layout), doc["beside"] == true)
    {:ok, put_heights(tree, panels)}
  end

  defp read_tree(layout, doc) do
    case TreeJson.parse(doc["tree"], Enum.map(layout.panels, & &1.id)) do
      {:ok, tree} -> {:ok, tree}
      {:error, why} -> layout_error(why)
    end
  end

  defp row_of({%Panel{panel: kind, id: id}, doc}),
    do: if(Layout.timeline?(kind), do: id, else: doc["row"] || "r" <> id)

  # The height of a row was a property of its panels.
  defp put_heights(tree, panels) do
    for {panel, %{"height" => height}} <- panels, height != nil, reduce: tree do
      tree -> put_height(tree, Tree.ancestors(tree, panel.id), panel.id, height)
    end
  end

  defp put_height(tree, [{%Tree{way: :column}, _} | _], id, height),
    do: Tree.update(tree, id, &%{&1 | size: height})

  defp put_height(tree, [{%Tree{way: :row, id: id}, _} | [_ | _]], _, height),
    do: Tree.update(tree, id, &%{&1 | size: height})

  defp put_height(tree, _, _, _), do: tree

  defp parse_compared(%{"with" => id, "offset" => offset}) when is_binary(id) do
    case Int64.parse(offset) do
      {:ok, offset} -> {id, offset}
      :error -> nil
    end
  end

  defp parse_compared(_), do: nil

  defp read_panels(name, panels) do
    read = Enum.map(panels, &read_panel/1)

    case Enum.find_index(read, &(&1 == :error)) || find_duplicate_id(read) do
      nil ->
        next = read |> Enum.map(&panel_number/1) |> Enum.max(fn -> 0 end)
        {:ok, %Layout{name: name, panels: read, next: next + 1}}

      {:twice, id} ->
        layout_error("two panels have the id #{id}")

      i ->
        layout_error("panel #{i + 1} is invalid")
    end
  end

  defp find_duplicate_id(panels) do
    ids = Enum.map(panels, & &1.id)
    with [id | _] <- ids -- Enum.uniq(ids), do: {:twice, id}, else: (_ -> nil)
  end

  defp read_panel(%{"id" => id, "panel" => panel, "vis" => vis} = doc)
       when is_binary(id) and is_binary(panel) and is_list(vis) do
    kind = Enum.find(Layout.panel_kinds(), &(Atom.to_string(&1) == panel))
    vis = Enum.map(vis, &read_vis/1)
    row = doc["row"]

    if kind && id =~ @id && :error not in vis && length(vis) <= @max_vis &&
         (doc["height"] == nil or doc["height"] in @heights) &&
         (row == nil or (is_binary(row) and row =~ @id)) do
      %Panel{
        id: id,
        panel: kind,
        aspect: parse_aspect(doc["aspect"]),
        vis: vis,
        axis: parse_axis(doc["axis"]),
        threshold: parse_threshold(doc["threshold"])
      }
    else
      :error
    end
  end

  defp read_panel(_), do: :error

  defp parse_aspect(ratio) when is_number(ratio) and ratio >= 0.1 and ratio <= 20, do: ratio / 1
  defp parse_aspect(_), do: nil

  defp parse_axis([min, max]) when is_number(min) and is_number(max) and min < max, do: {min, max}
  defp parse_axis("own"), do: :own
  defp parse_axis(_), do: nil

  defp parse_threshold(["below", value]) when is_number(value), do: {:below, value}
  defp parse_threshold(["above", value]) when is_number(value), do: {:above, value}
  defp parse_threshold(_), do: nil

  defp read_vis(%{"viz" => viz, "stream" => stream} = doc)
       when is_binary(viz) and is_binary(stream) do
    path = doc["path"] || ""
    props = doc["props"] || %{}

    if is_binary(path) and is_map(props) and
         Enum.all?(props, fn {_, v} -> is_binary(v) or is_number(v) or is_boolean(v) end),
       do: %Visualization{viz: viz, stream: stream, path: path, props: props},
       else: :error
  end

  defp read_vis(_), do: :error

  defp panel_number(%Panel{id: "p" <> n}) do
    case Integer.parse(n) do
      {i, ""} -> i
      _ -> 0
    end
  end

  defp panel_number(_), do: 0

  defp layout_error(why) do
    {:error,
     Error.new(:bad_layout, "this file is not a layout: #{why}",
       fix: "open a different file, or save this view under a new name"
     )}
  end
end
