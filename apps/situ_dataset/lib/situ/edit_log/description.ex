defmodule Situ.EditLog.Description do
  @moduledoc false
  # Describes operations in plain words, for histories and errors.
  alias Situ.EditLog.{Changes, Entry}

  @kinds %{
    "sessions" => "session",
    "partitions" => "partition",
    "tags" => "tag",
    "metadata" => "metadata"
  }
  @longest 60

  @doc """
  Describes a change of a JSON document.

      iex> Situ.EditLog.Description.describe_change(["set", ["sessions", "p1", "metadata", "age"], 30, 31])
      "set metadata age of session p1 from 30 to 31"
      iex> Situ.EditLog.Description.describe_change(["add", ["sessions", "p1", "tags", "pilot"], "pilot", nil])
      "add tag pilot to session p1"
      iex> Situ.EditLog.Description.describe_change(["rename", ["sessions", "p1"], "p1", "p2"])
      "rename session p1 to p2"
  """
  @spec describe_change(Changes.change()) :: String.t()
  def describe_change(["add", path, value, _]) do
    {item, owners} = split_path(path)
    "add #{item}#{value_suffix(path, value)}#{join_owners("to", owners)}"
  end

  def describe_change(["remove", path, value, _]) do
    {item, owners} = split_path(path)
    "remove #{item}#{value_suffix(path, value)}#{join_owners("from", owners)}"
  end

  def describe_change(["set", path, before, later]) do
    {item, owners} = split_path(path)
    "set #{item}#{join_owners("of", owners)} from #{show_value(before)} to #{show_value(later)}"
  end

  def describe_change(["rename", path, _from, to]) do
    {item, owners} = split_path(path)
    "rename #{item}#{join_owners("of", owners)} to #{to}"
  end

  def describe_change(["order", path, _, _]) do
    {item, owners} = split_path(path)
    "sort the #{item}#{join_owners("of", owners)}"
  end

  def describe_change(_), do: "an unknown change"

  # Splits a path into its last part and the things that contain it, innermost first.
  defp split_path([]), do: {"the document", []}

  defp split_path(path) do
    [item | owners] = path |> group_path() |> Enum.reverse()
    {item, owners}
  end

  defp group_path([kind, name | rest]) when is_map_key(@kinds, kind),
    do: ["#{@kinds[kind]} #{name}" | group_path(rest)]

  defp group_path([key | rest]), do: [key | group_path(rest)]
  defp group_path([]), do: []

  defp join_owners(_word, []), do: ""
  defp join_owners(word, owners), do: " #{word} " <> Enum.join(owners, " of ")

  defp value_suffix(path, value) when is_map(value) or is_list(value) do
    if length(path) == 2 and hd(path) == "sessions", do: "", else: value_details(value)
  end

  defp value_suffix(path, value),
    do: if(List.last(path) == value, do: "", else: " = #{show_value(value)}")

  defp value_details(%{"path" => path}), do: " (#{path})"
  defp value_details(value), do: " = #{show_value(value)}"

  defp show_value(nil), do: "nothing"

  defp show_value(value) do
    text = Situ.JSON.encode(value)
    if String.length(text) > @longest, do: String.slice(text, 0, @longest) <> "...", else: text
  end

  @doc "Describes an entry in one line. `describe` returns the lines for the operation of an edit."
  @spec describe_entry(Entry.t(), (Entry.t() -> [String.t()])) :: String.t()
  def describe_entry(entry, describe \\ &describe_changes/1)
  def describe_entry(%{kind: "undo", of: n}, _), do: "undo #{n}"
  def describe_entry(%{kind: "redo", of: n}, _), do: "redo #{n}"

  def describe_entry(%{kind: "name", of: n, note: name}, _),
    do: "name version #{n} #{inspect(name)}"

  def describe_entry(%{kind: "restore", of: n} = entry, describe),
    do: "restore version #{n} (#{count_lines(describe.(entry))})"

  def describe_entry(entry, describe) do
    note = if entry.note, do: "#{entry.note}: ", else: ""
    note <> shorten_lines(describe.(entry))
  end

  defp count_lines([_]), do: "1 change"
  defp count_lines(lines), do: "#{length(lines)} changes"

  defp shorten_lines(lines) when length(lines) <= 3, do: Enum.join(lines, "; ")

  defp shorten_lines(lines),
    do: Enum.join(Enum.take(lines, 2), "; ") <> "; and #{length(lines) - 2} more changes"

  @doc "Returns an entry for users: version, kind, time, person, program, computer, and the operation in plain words."
  @spec summarize_entry(Entry.t(), (Entry.t() -> [String.t()])) :: map()
  def summarize_entry(entry, describe \\ &describe_changes/1) do
    entry
    |> Map.take([:kind, :at, :program, :host])
    |> Map.merge(%{
      version: entry.n,
      by: entry.by || entry.user,
      what: describe_entry(entry, describe)
    })
  end

  @doc "Describes the changes of an entry of a JSON document."
  @spec describe_changes(Entry.t()) :: [String.t()]
  def describe_changes(%{do: %{"changes" => changes}}) when is_list(changes),
    do: Enum.map(changes, &describe_change/1)

  def describe_changes(_entry), do: []
end
