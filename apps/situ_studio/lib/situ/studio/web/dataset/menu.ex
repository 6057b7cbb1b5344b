defmodule Situ.Studio.Web.Dataset.Menu do
  @moduledoc """
  The menus of a dataset's tree, as the page shows them under the right mouse button and behind the dots of a row: a
  list of `%{text:, event: | href: | copy:}`, where `sure` asks a second time and `-` is a line.
  """
  alias Situ.Studio.Datasets.Place
  alias Situ.Studio.Web.Address

  @doc "The menu of a row as JSON; without what writes where the studio is read only."
  @spec of(map(), map()) :: String.t()
  def of(row, %{id: id, tasks: tasks, read_only: read_only}) do
    row
    |> items(id, tasks)
    |> Enum.reject(
      &(read_only and is_map(&1) and is_map_key(&1, :event) and
          &1.event not in ["select", "fold_below"])
    )
    |> tidy()
    |> Situ.JSON.encode()
  end

  # No line at either end, and no two.
  defp tidy(items) do
    items
    |> Enum.dedup_by(&if(&1 == "-", do: "-", else: make_ref()))
    |> Enum.drop_while(&(&1 == "-"))
    |> Enum.reverse()
    |> Enum.drop_while(&(&1 == "-"))
    |> Enum.reverse()
  end

  defp items(%{kind: :dataset} = row, _id, tasks) do
    [
      event("Properties", "select", row),
      "-",
      event("New session…", "ask", row, %{what: "session"}),
      event("Add recordings as sessions…", "recordings", row),
      event("Add a folder as one session…", "folders", row, %{what: "session"}),
      event("Add each folder in a folder as a session…", "folders", row, %{what: "sessions"}),
      "-"
    ] ++
      tasks(row, tasks) ++
      [
        "-",
        event("Note checksums of all recordings", "seal", row),
        event("Save a copy as…", "ask", row, %{what: "copy"}),
        %{text: "Copy its name", copy: row.label}
      ] ++ folding(row)
  end

  defp items(%{kind: :session, path: path} = row, id, tasks) do
    open(id, path) ++
      [
        event("Properties", "select", row),
        "-",
        event("Add recordings…", "recordings", row),
        event("Add all recordings of a folder…", "folders", row, %{what: "recordings"}),
        event("Rename…", "ask", row, %{what: "rename"}),
        "-"
      ] ++
      tasks(row, tasks) ++
      ["-", %{text: "Copy its name", copy: row.label}] ++
      folding(row) ++
      [
        "-",
        event("Remove from the dataset", "remove", row, %{
          sure: "Remove #{row.label} from the dataset? Its recordings stay on the disk."
        }),
        event("Delete with its recordings…", "delete", row, %{
          sure: "Delete all recordings of #{row.label} from the disk, for ever?"
        })
      ]
  end

  defp items(%{kind: :partition, path: [session, _] = path} = row, id, _tasks) do
    open(id, path) ++
      [
        event("Properties", "select", row),
        "-",
        event("Save a part as a recording…", "export", row),
        event("Rename…", "ask", row, %{what: "rename"}),
        event("Take another recording for it…", "relocate", row),
        "-",
        %{text: "Copy its name", copy: row.label},
        %{text: "Copy the name of its session", copy: session}
      ] ++
      place(row) ++
      folding(row) ++
      [
        "-",
        event("Remove from the session", "remove", row, %{
          sure: "Remove #{row.label} from its session? The recording stays on the disk."
        }),
        event("Remove from all sessions", "remove_all", row, %{
          sure: "Remove #{row.label} from every session? The recordings stay on the disk."
        }),
        event("Delete the recording…", "delete", row, %{
          sure: "Delete the recording #{row.label} from the disk, for ever?"
        }),
        event("Delete it in all sessions…", "delete_all", row, %{
          sure: "Delete the recordings #{row.label} of every session from the disk, for ever?"
        })
      ]
  end

  defp items(%{kind: :stream, path: [session, partition, stream]} = row, id, _tasks) do
    href =
      Address.of(Place.id(id, [session, partition])) <>
        "?" <> URI.encode_query(%{"stream" => stream})

    [
      %{text: "Open", href: href},
      %{text: "Open in a new tab", href: href, tab: true},
      "-",
      event("Properties", "select", row),
      "-",
      %{text: "Copy its name", copy: stream},
      %{text: "Copy its address in the session", copy: "[#{partition}]:#{stream}"},
      %{text: "Copy the name of its recording", copy: partition},
      %{text: "Copy the name of its session", copy: session}
    ] ++
      place(row) ++
      if(row.stream.type, do: [%{text: "Copy its type", copy: row.stream.type}], else: [])
  end

  defp place(%{file: file}) when is_binary(file) do
    [
      %{text: "Copy the name of its recording on disk", copy: Path.basename(file)},
      %{text: "Copy the path of its recording", copy: file},
      %{text: "Copy the path of its folder", copy: Path.dirname(file)}
    ]
  end

  defp place(_), do: []

  # Of what stands below a row.
  defp folding(row) do
    [
      event("Unfold all below it", "fold_below", row, %{open: true}),
      event("Fold all below it", "fold_below", row, %{open: false})
    ]
  end

  defp open(id, path) do
    href = Address.of(Place.id(id, path))
    [%{text: "Open", href: href}, %{text: "Open in a new tab", href: href, tab: true}, "-"]
  end

  defp tasks(row, tasks),
    do: for(task <- tasks, do: event("Run #{task.name}…", "task", row, %{task: task.name}))

  defp event(text, event, row, more \\ %{}) do
    {sure, more} = Map.pop(more, :sure)
    item = %{text: text, event: event, value: Map.put(more, :path, row.path)}
    if sure, do: Map.put(item, :sure, sure), else: item
  end
end
