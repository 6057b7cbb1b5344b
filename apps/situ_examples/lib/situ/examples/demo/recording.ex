defmodule Situ.Examples.Demo.Recording do
  @moduledoc """
  The content of a recording of the demo: who was seen where, who spoke when, and how late each decision came.

    * `frames`: pictures with a decision; `media_s`: how long they last
    * `found`: per picture, its time from the first and the faces with their rectangles and whether they speak
    * `spoken`: `{face id, from, to}` in nanoseconds from the first picture, in the order of time
    * `utterances`: `Situ.Infer.Speech.Utterance`s, with times from the first picture
    * `latency_ms`: `{median, 95th percentile}` from a picture to the decision on it
  """
  alias Situ.Store

  @enforce_keys [:frames, :media_s, :found, :spoken, :latency_ms, :missing]
  defstruct [:frames, :media_s, :found, :spoken, :latency_ms, :missing, utterances: []]

  @type t :: %__MODULE__{}

  @doc "Reads the store at `path`."
  @spec read(Path.t()) :: {:ok, t()} | {:error, Situ.Error.t()}
  def read(path) do
    with {:ok, store} <- Store.open(path) do
      names = store |> Store.streams() |> Enum.map(& &1.name)
      speaking = messages(store, names, "Talk.Speaking")
      mouths = messages(store, names, "Talk.Mouths") |> Map.new(&{&1.originating_time, &1.data})

      {:ok,
       %__MODULE__{
         frames: length(speaking),
         media_s: media_s(speaking),
         found: found(speaking, mouths),
         spoken: spoken(speaking),
         latency_ms: latency(speaking),
         utterances: utterances(messages(store, names, "Talk.Transcript"), speaking),
         missing:
           for(
             {name, what} <- [{"Talk.Sound", :sound}, {"Talk.Pictures", :pictures}],
             name not in names,
             do: what
           )
       }}
    end
  end

  defp messages(store, names, name),
    do: if(name in names, do: store |> Store.messages(name) |> Enum.to_list(), else: [])

  # Without pictures times count from the beginning of the sound, as they are.
  defp utterances(said, speaking) do
    zero = if speaking == [], do: 0, else: hd(speaking).originating_time
    for %{data: u} <- said, do: %{u | from: u.from - zero, to: u.to - zero}
  end

  defp found([], _mouths), do: []

  defp found([first | _] = speaking, mouths) do
    for message <- speaking do
      faces = Map.get(mouths, message.originating_time, %{})
      seen = for {id, speaks?} <- message.data, mouth = faces[id], do: {mouth.rect, speaks?}
      {message.originating_time - first.originating_time, seen}
    end
  end

  defp spoken([]), do: []

  defp spoken([first | _] = speaking) do
    ids = speaking |> Enum.flat_map(&Map.keys(&1.data)) |> Enum.uniq() |> Enum.sort()

    ids
    |> Enum.flat_map(fn id ->
      speaking
      |> Enum.chunk_by(&(&1.data[id] == true))
      |> Enum.filter(fn [m | _] -> m.data[id] == true end)
      |> Enum.map(fn run ->
        from = hd(run).originating_time - first.originating_time
        {id, from, List.last(run).originating_time - first.originating_time}
      end)
    end)
    |> Enum.sort_by(fn {id, from, _} -> {from, id} end)
  end

  defp media_s([first, _ | _] = speaking) do
    last = List.last(speaking)
    n = length(speaking)
    # The last picture lasts as long as the others do on average.
    (last.originating_time - first.originating_time) / (n - 1) * n / 1.0e9
  end

  defp media_s(_), do: 0.0

  defp latency([]), do: {nil, nil}

  defp latency(speaking) do
    sorted = speaking |> Enum.map(&(Situ.Message.latency(&1) / 1.0e6)) |> Enum.sort()
    at = fn q -> Enum.at(sorted, min(round(q * length(sorted)), length(sorted) - 1)) end
    {at.(0.5), at.(0.95)}
  end
end
