defmodule Situ.Studio.Web.MainAssigns do
  @moduledoc false
  # Derives the values that the main view renders from its assigns: the rows of the stream tree, the selected stream,
  # group or panel, and the changes to the layout. Pure.
  alias Situ.Studio.{Layout, Link}
  alias Situ.Studio.Web.{Paths, StreamTree}

  @doc "Returns the derived values, to be added to the assigns."
  @spec derive_values(map()) :: keyword()
  def derive_values(assigns) do
    {rows, more} = StreamTree.visible_rows(assigns)

    [
      rows: rows,
      more: more,
      known:
        assigns
        |> Map.take([:shapes, :extra, :lanes, :coverage, :colors])
        |> Map.put(:damaged, assigns.damage != []),
      stream: selected_stream(assigns),
      group: StreamTree.selected_group(assigns),
      panel: selected_panel(assigns),
      start: first_cell_time(assigns.layout, assigns.infos),
      more_streams: count_more(assigns),
      edit: encode_edit(assigns.layout, assigns.saved),
      pipeline: pipeline_path(assigns.item, assigns.infos)
    ]
  end

  # The time at which every image and other cell has content, if it is in the first half of the data; else `nil`.
  defp first_cell_time(layout, infos) do
    cells =
      for %{panel: panel, vis: [vis | _]} <- layout.panels,
          not Layout.timeline?(panel),
          do: vis.stream

    starts = for %{first: first, name: name} <- infos, first != nil, name in cells, do: first

    with [_ | _] <- starts,
         start = Enum.max(starts),
         %{first: from, last: to} <- extent(infos),
         true <- start > from and start - from <= div(to - from, 2),
         do: Integer.to_string(start),
         else: (_ -> nil)
  end

  defp extent(infos) do
    times = for %{first: first, last: last} <- infos, first != nil, do: {first, last}
    {firsts, lasts} = Enum.unzip(times)
    %{first: Enum.min(firsts), last: Enum.max(lasts)}
  end

  # A layout with a name contains the streams that somebody wanted.
  defp count_more(%{saved: saved, layout: layout, infos: infos}) do
    if saved.name == Layout.Auto.layout_name(),
      do: length(Layout.left_out(layout, infos)),
      else: 0
  end

  defp selected_stream(%{selected: {:stream, name}, infos: streams}),
    do: Enum.find(streams, &(&1.name == name))

  defp selected_stream(_), do: nil

  defp selected_panel(%{selected: {:panel, id}, layout: layout}),
    do: Layout.find_panel(layout, id)

  defp selected_panel(_), do: nil

  # Returns the changed layout for the page's address, or "" if it is the same as the saved one.
  defp encode_edit(layout, saved) do
    if Layout.same_panels?(layout, saved),
      do: "",
      else: Link.encode(layout)
  end

  # Returns the path of the graph page for a running pipeline, or for a recording that contains diagnostics.
  defp pipeline_path(item, infos) do
    if item.kind == :pipeline or
         Enum.any?(infos, &String.contains?(to_string(&1.type), "Diagnostics.Snapshot")),
       do: Paths.pipeline_path(item.id)
  end
end
