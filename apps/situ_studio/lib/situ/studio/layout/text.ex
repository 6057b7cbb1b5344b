defmodule Situ.Studio.Layout.Text do
  @moduledoc false
  # Converts layouts to and from JSON text, for files and addresses. The text is untrusted.
  alias Situ.Error
  alias Situ.Studio.{Layout, WholeNumber}
  alias Situ.Studio.Layout.{Panel, Vis}

  @version 1
  @heights 28..2_000
  @id ~r/\A[a-z0-9]{1,16}\z/
  @max_panels elem(Layout.limits(), 0)
  @max_vis elem(Layout.limits(), 1)

  @spec write(Layout.t()) :: String.t()
  def write(%Layout{} = layout) do
    doc = %{
      "version" => @version,
      "name" => layout.name,
      "panels" => Enum.map(layout.rows, &panel_json/1)
    }

    doc = if layout.beside, do: Map.put(doc, "beside", true), else: doc
    doc |> put("compared", compared_json(layout.compared)) |> Situ.JSON.pretty()
  end

  # The offset is a string, because other programs do not keep integers of this size exact.
  defp compared_json({id, offset}), do: %{"with" => id, "offset" => Integer.to_string(offset)}
  defp compared_json(nil), do: nil

  defp panel_json(%Panel{} = p) do
    vis =
      for v <- p.vis,
          do: %{"viz" => v.viz, "stream" => v.stream, "path" => v.path, "props" => v.props}

    %{"id" => p.id, "panel" => Atom.to_string(p.panel), "vis" => vis}
    |> put("row", p.row)
    |> put("height", p.height)
    |> put("axis", axis_json(p.axis))
    |> put("threshold", p.threshold && Tuple.to_list(p.threshold))
  end

  defp axis_json({min, max}), do: [min, max]
  defp axis_json(:own), do: "own"
  defp axis_json(nil), do: nil

  defp put(map, _, nil), do: map
  defp put(map, key, value), do: Map.put(map, key, value)

  @spec read(binary()) :: {:ok, Layout.t()} | {:error, Error.t()}
  def read(json) do
    case Situ.JSON.decode(json) do
      {:ok, %{"version" => @version, "name" => name, "panels" => panels} = doc}
      when is_binary(name) and is_list(panels) and length(panels) <= @max_panels ->
        with {:ok, layout} <- read_panels(name, panels),
             do:
               {:ok,
                %{layout | beside: doc["beside"] == true, compared: compared(doc["compared"])}}

      {:ok, %{"version" => version}} when version != @version ->
        bad("it has version #{inspect(version)}, but this studio reads #{@version}")

      {:ok, _} ->
        bad("it must contain \"version\", \"name\" and \"panels\"")

      {:error, :bad_json} ->
        bad("it is not JSON")
    end
  end

  defp compared(%{"with" => id, "offset" => offset}) when is_binary(id) do
    case WholeNumber.parse(offset) do
      {:ok, offset} -> {id, offset}
      :error -> nil
    end
  end

  defp compared(_), do: nil

  defp read_panels(name, panels) do
    read = Enum.map(panels, &read_panel/1)

    case Enum.find_index(read, &(&1 == :error)) || twice(read) do
      nil ->
        next = read |> Enum.map(&number/1) |> Enum.max(fn -> 0 end)
        {:ok, %Layout{name: name, rows: read, next: next + 1}}

      {:twice, id} ->
        bad("two panels have the id #{id}")

      i ->
        bad("panel #{i + 1} is invalid")
    end
  end

  defp twice(panels) do
    ids = Enum.map(panels, & &1.id)
    with [id | _] <- ids -- Enum.uniq(ids), do: {:twice, id}, else: (_ -> nil)
  end

  defp read_panel(%{"id" => id, "panel" => panel, "vis" => vis} = doc)
       when is_binary(id) and is_binary(panel) and is_list(vis) do
    kind = Enum.find(Layout.panels(), &(Atom.to_string(&1) == panel))
    vis = Enum.map(vis, &read_vis/1)
    row = doc["row"]

    if kind && id =~ @id && :error not in vis && length(vis) <= @max_vis &&
         (doc["height"] == nil or doc["height"] in @heights) &&
         (row == nil or (is_binary(row) and row =~ @id)) do
      %Panel{
        id: id,
        panel: kind,
        row: if(Layout.timeline?(kind), do: nil, else: row || "r" <> id),
        height: doc["height"],
        vis: vis,
        axis: axis(doc["axis"]),
        threshold: threshold(doc["threshold"])
      }
    else
      :error
    end
  end

  defp read_panel(_), do: :error

  defp axis([min, max]) when is_number(min) and is_number(max) and min < max, do: {min, max}
  defp axis("own"), do: :own
  defp axis(_), do: nil

  defp threshold(["below", value]) when is_number(value), do: {:below, value}
  defp threshold(["above", value]) when is_number(value), do: {:above, value}
  defp threshold(_), do: nil

  defp read_vis(%{"viz" => viz, "stream" => stream} = doc)
       when is_binary(viz) and is_binary(stream) do
    path = doc["path"] || ""
    props = doc["props"] || %{}

    if is_binary(path) and is_map(props) and
         Enum.all?(props, fn {_, v} -> is_binary(v) or is_number(v) or is_boolean(v) end),
       do: %Vis{viz: viz, stream: stream, path: path, props: props},
       else: :error
  end

  defp read_vis(_), do: :error

  defp number(%Panel{id: "p" <> n}) do
    case Integer.parse(n) do
      {i, ""} -> i
      _ -> 0
    end
  end

  defp number(_), do: 0

  defp bad(why) do
    {:error,
     Error.new(:bad_layout, "this file is not a layout: #{why}",
       fix: "open a different file, or save this view under a new name"
     )}
  end
end
