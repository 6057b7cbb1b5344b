defmodule Situ.Studio.Web.Dataset.RowMenu do
  @moduledoc false
  # Builds the context menus of a dataset's tree, which open with a right click or a row's "⋯"
  # button. A menu is a list of `%{text:, event: | href: | copy:}`; `sure` is a confirmation
  # question, and `-` is a separator.
  alias Situ.Studio.Datasets.DatasetRef
  alias Situ.Studio.Web.Paths

  @doc "Returns the menu of a row as JSON. In a read-only studio, it lacks the entries that modify something."
  @spec encode_menu(map(), map()) :: String.t()
  def encode_menu(row, %{id: id, tasks: tasks, read_only: read_only}) do
    row
    |> menu_items(id, tasks)
    |> Enum.reject(
      &(read_only and is_map(&1) and is_map_key(&1, :event) and
          &1.event not in ["select", "fold_below"])
    )
    |> trim_separators()
    |> Situ.JSON.encode()
  end

  # Removes separators at both ends, and repeated ones.
  defp trim_separators(items) do
    items
    |> Enum.dedup_by(&if(&1 == "-", do: "-", else: make_ref()))
    |> Enum.drop_while(&(&1 == "-"))
    |> Enum.reverse()
    |> Enum.drop_while(&(&1 == "-"))
    |> Enum.reverse()
  end

  defp menu_items(%{kind: :dataset} = row, _id, tasks) do
    [
      event_item("Properties", "select", row),
      "-",
      event_item("New session…", "ask", row, %{what: "session"}),
      event_item("Add recordings as sessions…", "recordings", row),
      event_item("Add a folder as one session…", "folders", row, %{what: "session"}),
      event_item("Add each subfolder of a folder as a session…", "folders", row, %{
        what: "sessions"
      }),
      "-"
    ] ++
      task_items(row, tasks) ++
      [
        "-",
        event_item("Save checksums of all recordings", "seal", row),
        event_item("Save a copy as…", "ask", row, %{what: "copy"}),
        %{text: "Copy name", copy: row.label}
      ] ++ fold_items(row)
  end

  defp menu_items(%{kind: :session, path: path} = row, id, tasks) do
    open_items(id, path) ++
      [
        event_item("Properties", "select", row),
        "-",
        event_item("Add recordings…", "recordings", row),
        event_item("Add all recordings of a folder…", "folders", row, %{what: "recordings"}),
        event_item("Rename…", "ask", row, %{what: "rename"}),
        "-"
      ] ++
      task_items(row, tasks) ++
      ["-", %{text: "Copy name", copy: row.label}] ++
      fold_items(row) ++
      [
        "-",
        event_item("Remove from the dataset", "remove", row, %{
          sure: "Remove #{row.label} from the dataset? Its recordings stay on disk."
        }),
        event_item("Delete with its recordings…", "delete", row, %{
          sure: "Permanently delete all recordings of #{row.label} from disk?"
        })
      ]
  end

  defp menu_items(%{kind: :partition, path: [session, _] = path} = row, id, tasks) do
    open_items(id, path) ++
      [event_item("Properties", "select", row), "-"] ++
      task_items(row, tasks) ++
      [
        "-",
        event_item("Save a section as a recording…", "export", row),
        event_item("Rename…", "ask", row, %{what: "rename"}),
        event_item("Use another recording…", "relocate", row),
        "-",
        %{text: "Copy name", copy: row.label},
        %{text: "Copy session name", copy: session}
      ] ++
      copy_path_items(row) ++
      fold_items(row) ++
      [
        "-",
        event_item("Remove from the session", "remove", row, %{
          sure: "Remove #{row.label} from its session? The recording stays on disk."
        }),
        event_item("Remove from all sessions", "remove_all", row, %{
          sure: "Remove #{row.label} from every session? The recordings stay on disk."
        }),
        event_item("Delete the recording…", "delete", row, %{
          sure: "Permanently delete the recording #{row.label} from disk?"
        }),
        event_item("Delete it in all sessions…", "delete_all", row, %{
          sure: "Permanently delete the recordings named #{row.label} of every session from disk?"
        })
      ]
  end

  defp menu_items(%{kind: :stream, path: [session, partition, stream]} = row, id, _tasks) do
    href =
      Paths.source_path(DatasetRef.build_id(id, [session, partition])) <>
        "?" <> URI.encode_query(%{"stream" => stream})

    [
      %{text: "Open", href: href},
      %{text: "Open in a new tab", href: href, tab: true},
      "-",
      event_item("Properties", "select", row),
      "-",
      %{text: "Copy name", copy: stream},
      %{text: "Copy address within the session", copy: "[#{partition}]:#{stream}"},
      %{text: "Copy recording name", copy: partition},
      %{text: "Copy session name", copy: session}
    ] ++
      copy_path_items(row) ++
      if(row.stream.type, do: [%{text: "Copy type", copy: row.stream.type}], else: [])
  end

  defp copy_path_items(%{file: file}) when is_binary(file) do
    [
      %{text: "Copy file name", copy: Path.basename(file)},
      %{text: "Copy file path", copy: file},
      %{text: "Copy folder path", copy: Path.dirname(file)}
    ]
  end

  defp copy_path_items(_), do: []

  # Entries that fold or unfold everything below a row.
  defp fold_items(row) do
    [
      event_item("Unfold all below", "fold_below", row, %{open: true}),
      event_item("Fold all below", "fold_below", row, %{open: false})
    ]
  end

  defp open_items(id, path) do
    href = Paths.source_path(DatasetRef.build_id(id, path))
    [%{text: "Open", href: href}, %{text: "Open in a new tab", href: href, tab: true}, "-"]
  end

  defp task_items(row, tasks),
    do: for(task <- tasks, do: event_item("Run #{task.name}…", "task", row, %{task: task.name}))

  defp event_item(text, event, row, more \\ %{}) do
    {sure, more} = Map.pop(more, :sure)
    item = %{text: text, event: event, value: Map.put(more, :path, row.path)}
    if sure, do: Map.put(item, :sure, sure), else: item
  end
end
