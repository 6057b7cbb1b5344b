defmodule Situ.Studio.Web.Dataset.Rows do
  @moduledoc false
  # Builds the rows of a dataset's tree: the dataset, its sessions, their recordings, and the
  # streams of the recordings. A search filters the sessions.
  alias Situ.Dataset
  alias Situ.Studio.Datasets.Summary
  alias Situ.Studio.StreamTotals

  @typedoc "A row of the tree. Its `path` has the names of session, partition and stream, as far as they apply."
  @type row :: %{
          path: [String.t()],
          kind: :dataset | :session | :partition | :stream,
          label: String.t(),
          open?: boolean() | nil,
          figures: StreamTotals.t() | nil,
          facts: Summary.t() | nil,
          file: Path.t() | nil,
          stream: Situ.Studio.StreamInfo.t() | nil,
          tags: [String.t()],
          trouble: String.t() | nil
        }

  @doc "Returns the visible rows; `facts` maps the paths of recordings to the facts loaded so far."
  @spec visible_rows(Dataset.t(), %{Path.t() => Summary.t()}, MapSet.t([String.t()]), String.t()) ::
          [row()]
  def visible_rows(%Dataset{} = dataset, facts, open, query) do
    sessions = matching_sessions(dataset, facts, query)
    known = for s <- dataset.sessions, do: for(p <- s.partitions, f = facts[p.path], do: f)
    sums = Enum.map(known, &Summary.sum_figures/1)
    figures = known |> Enum.concat() |> Summary.sum_figures() |> StreamTotals.add_lengths(sums)

    [
      build_row([], :dataset, dataset.name, figures: figures, tags: dataset.tags)
      | Enum.flat_map(sessions, &session_rows(&1, facts, open))
    ]
  end

  @doc "Returns the sessions that match the search of the tree."
  @spec matching_sessions(Dataset.t(), %{Path.t() => Summary.t()}, String.t()) ::
          [Dataset.Session.t()]
  def matching_sessions(%Dataset{} = dataset, facts, query) do
    words = query |> String.downcase() |> String.split()
    Enum.filter(dataset.sessions, &matches?(&1, facts, words))
  end

  defp build_row(path, kind, label, more) do
    Map.merge(
      %{
        path: path,
        kind: kind,
        label: label,
        open?: nil,
        facts: nil,
        figures: nil,
        file: nil,
        stream: nil,
        tags: [],
        trouble: nil
      },
      Map.new(more)
    )
  end

  defp session_rows(session, facts, open) do
    known = for p <- session.partitions, f = facts[p.path], do: f
    open? = MapSet.member?(open, [session.name])
    troubles = Enum.count(known, &(&1.error != nil))

    own =
      build_row([session.name], :session, session.name,
        open?: open?,
        facts: Summary.merge_facts(known),
        figures: if(known != [] or session.partitions == [], do: Summary.sum_figures(known)),
        tags: session.tags,
        trouble:
          if(troubles > 0, do: "#{troubles} of #{length(session.partitions)} cannot be opened")
      )

    if open?,
      do: [
        own | Enum.flat_map(session.partitions, &partition_rows(session, &1, facts, open))
      ],
      else: [own]
  end

  defp partition_rows(session, partition, facts, open) do
    path = [session.name, partition.name]
    known = facts[partition.path]
    open? = MapSet.member?(open, path)
    error = known && known.error

    own =
      build_row(path, :partition, partition.name,
        open?: open?,
        facts: known,
        figures: known && Summary.sum_figures([known]),
        file: partition.path,
        trouble:
          cond do
            error -> error.what
            known && known.damaged -> "damaged"
            true -> nil
          end
      )

    streams = if open? and known, do: known.streams, else: []

    [
      own
      | for s <- streams do
          build_row(path ++ [s.name], :stream, s.name,
            stream: s,
            figures: StreamTotals.sum_streams([s]),
            file: partition.path
          )
        end
    ]
  end

  # Every word must occur in the session's name, tags or metadata, or in the names of its recordings or their streams.
  defp matches?(_session, _facts, []), do: true

  defp matches?(session, facts, words) do
    streams = for p <- session.partitions, f = facts[p.path], s <- f.streams, do: s.name
    names = Enum.map(session.partitions, & &1.name)
    values = Enum.map(session.metadata, fn {k, v} -> "#{k} #{format_value(v)}" end)

    text =
      ([session.name | session.tags] ++ names ++ values ++ streams)
      |> Enum.join("\n")
      |> String.downcase()

    Enum.all?(words, &String.contains?(text, &1))
  end

  @doc """
  Formats metadata for editing, one entry per line. Values that are not strings are written as JSON.

      iex> Situ.Studio.Web.Dataset.Rows.format_metadata(%{"age" => 31, "room" => "A 3"})
      "age: 31\\nroom: A 3"
      iex> Situ.Studio.Web.Dataset.Rows.parse_metadata("age: 31\\nroom: A 3\\n\\nparts: [1, 2]")
      {:ok, %{"age" => 31, "parts" => [1, 2], "room" => "A 3"}}
      iex> {:error, error} = Situ.Studio.Web.Dataset.Rows.parse_metadata("nothing")
      iex> error.what
      "line 1 is not NAME: VALUE"
  """
  @spec format_metadata(map()) :: String.t()
  def format_metadata(metadata),
    do:
      metadata |> Enum.sort() |> Enum.map_join("\n", fn {k, v} -> "#{k}: #{format_value(v)}" end)

  defp format_value(value) when is_binary(value) do
    # A string that would be parsed as another JSON value is quoted.
    if parse_value(value) == value, do: value, else: Situ.JSON.encode(value)
  end

  defp format_value(value), do: Situ.JSON.encode(value)

  @doc "Parses metadata from such lines."
  @spec parse_metadata(String.t()) :: {:ok, map()} | {:error, Situ.Error.t()}
  def parse_metadata(text) do
    text
    |> String.split(["\r\n", "\n"])
    |> Enum.with_index(1)
    |> Enum.reject(fn {line, _} -> String.trim(line) == "" end)
    |> Enum.reduce_while({:ok, %{}}, fn {line, number}, {:ok, all} ->
      case String.split(line, ":", parts: 2) do
        [name, value] ->
          {:cont, {:ok, Map.put(all, String.trim(name), parse_value(String.trim(value)))}}

        _ ->
          {:halt, {:error, Situ.Error.new(:bad_metadata, "line #{number} is not NAME: VALUE")}}
      end
    end)
  end

  defp parse_value(text) do
    case Situ.JSON.decode(text) do
      {:ok, value} -> value
      {:error, _} -> text
    end
  end
end
