defmodule Situ.Examples.Demo.RecordingSummary do
  @moduledoc """
  The content of a demo recording: which faces were seen where, who spoke when, and the latency of each decision.

    * `frames`: number of images with a decision; `media_s`: their duration
    * `found`: for each image, its time since the first image, and the faces with their rectangles and whether they
      speak; images without a decision have no faces
    * `spoken`: `{face id, from, to}` in nanoseconds since the first image, ordered by time
    * `utterances`: `Situ.Infer.Speech.Utterance`s, with times since the first image
    * `sync`: a `Situ.Infer.LipSync`, the estimated offset of the audio relative to the lips
    * `start`: the originating time of the first image
    * `latency_ms`: `{median, 95th percentile}` from an image to its decision
    * `missing`: which of `:sound` and `:pictures` the recording does not contain
  """
  alias Situ.Store

  @enforce_keys [:frames, :media_s, :found, :spoken, :latency_ms, :missing, :sync, :start]
  defstruct [
    :frames,
    :media_s,
    :found,
    :spoken,
    :latency_ms,
    :missing,
    :sync,
    :start,
    utterances: []
  ]

  @type t :: %__MODULE__{}

  @doc "Reads the store at `path`."
  @spec read(Path.t()) :: {:ok, t()} | {:error, Situ.Error.t()}
  def read(path) do
    with {:ok, store} <- Store.open(path) do
      names = store |> Store.streams() |> Enum.map(& &1.name)
      speaking = read_messages(store, names, "Talk.Speaking")
      mouths = read_pairs(store, names, "Talk.Mouths")
      voices = read_pairs(store, names, "Talk.Voice")
      pictures = picture_times(store, names)

      zero =
        Enum.min(Enum.take(pictures, 1) ++ originating_times(Enum.take(speaking, 1)), fn -> 0 end)

      {:ok,
       %__MODULE__{
         frames: length(speaking),
         media_s: media_s(speaking),
         found: find_faces(speaking, Map.new(mouths), pictures, zero),
         sync: Situ.Infer.LipSync.estimate_shift(mouths, voices),
         start: zero,
         spoken: speaking_intervals(speaking, zero),
         latency_ms: latency_percentiles(speaking),
         utterances: shift_utterances(read_messages(store, names, "Talk.Transcript"), zero),
         missing:
           for(
             {name, what} <- [{"Talk.Sound", :sound}, {"Talk.Pictures", :pictures}],
             name not in names,
             do: what
           )
       }}
    end
  end

  defp read_messages(store, names, name),
    do: if(name in names, do: store |> Store.messages(name) |> Enum.to_list(), else: [])

  defp read_pairs(store, names, name),
    do: for(m <- read_messages(store, names, name), do: {m.originating_time, m.data})

  # Without video or decisions, `zero` is 0, and the utterances keep their times.
  defp shift_utterances(said, zero),
    do: for(%{data: u} <- said, do: %{u | from: u.from - zero, to: u.to - zero})

  defp picture_times(store, names) do
    if "Talk.Pictures" in names do
      {:ok, messages} = Store.read(store, "Talk.Pictures", envelopes: true)
      originating_times(messages)
    else
      []
    end
  end

  defp originating_times(messages), do: Enum.map(messages, & &1.originating_time)

  defp find_faces(speaking, mouths, pictures, zero) do
    decided =
      Map.new(speaking, fn message ->
        faces = Map.get(mouths, message.originating_time, %{})
        seen = for {id, speaks?} <- message.data, mouth = faces[id], do: {mouth.rect, speaks?}
        {message.originating_time, seen}
      end)

    (pictures ++ Map.keys(decided))
    |> Enum.uniq()
    |> Enum.sort()
    |> Enum.map(&{&1 - zero, Map.get(decided, &1, [])})
  end

  defp speaking_intervals(speaking, zero) do
    ids = speaking |> Enum.flat_map(&Map.keys(&1.data)) |> Enum.uniq() |> Enum.sort()

    ids
    |> Enum.flat_map(fn id ->
      speaking
      |> Enum.chunk_by(&(&1.data[id] == true))
      |> Enum.filter(fn [m | _] -> m.data[id] == true end)
      |> Enum.map(fn run ->
        {id, hd(run).originating_time - zero, List.last(run).originating_time - zero}
      end)
    end)
    |> Enum.sort_by(fn {id, from, _} -> {from, id} end)
  end

  defp media_s([first, _ | _] = speaking) do
    last = List.last(speaking)
    n = length(speaking)
    # The duration of the last image is the mean duration of the others.
    (last.originating_time - first.originating_time) / (n - 1) * n / 1.0e9
  end

  defp media_s(_), do: 0.0

  defp latency_percentiles([]), do: {nil, nil}

  defp latency_percentiles(speaking) do
    sorted = speaking |> Enum.map(&(Situ.Message.latency(&1) / 1.0e6)) |> Enum.sort()
    at = fn q -> Enum.at(sorted, min(round(q * length(sorted)), length(sorted) - 1)) end
    {at.(0.5), at.(0.95)}
  end
end
