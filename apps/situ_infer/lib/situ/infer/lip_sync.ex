defmodule Situ.Infer.LipSync do
  @moduledoc """
  Estimates how far the audio of a recording lags or leads its video, from lips and voice.

      mouths = for m <- Situ.Store.messages(store, "Talk.Mouths"), do: {m.originating_time, m.data}
      voices = for m <- Situ.Store.messages(store, "Talk.Voice"), do: {m.originating_time, m.data}
      Situ.Infer.LipSync.estimate_shift(mouths, voices)
      #=> %Situ.Infer.LipSync{shift: 300_000_000, confidence: 0.71, windows: 38}

  For each shift of up to half a second, the voice in one-second windows is compared with the mouth that matches best:
  the score is the correlation of its opening with the loudness, as in `Situ.Infer.ActiveSpeaker`. The lips and voice of
  a real speaker match at only one shift, where the mean over all windows has a narrow peak. The confidence, 0 to 1, is
  how much higher that peak is than the best shift outside it. Voices from outside the image have no peak, so their
  confidence is low.
  """
  alias Situ.Infer.ActiveSpeaker.{Agreement, Moment}
  alias Situ.Infer.{Mouth, Voice}

  @enforce_keys [:shift, :confidence, :windows]
  defstruct [:shift, :confidence, :windows]

  @typedoc "`shift` is in nanoseconds, and positive if the audio is late; `windows` is the number of windows compared."
  @type t :: %__MODULE__{
          shift: integer(),
          confidence: float(),
          windows: non_neg_integer()
        }

  @most 500_000_000
  @step 20_000_000
  # Shifts this close to the best one belong to its peak.
  @peak 140_000_000
  @window 1_000_000_000
  @hop 200_000_000
  # A long recording is judged by at most this many windows, spread over all of it.
  @most_windows 300
  @min_pictures 8
  @voiced 0.5
  # Below these limits an estimate is a guess.
  @confident 0.5
  @min_windows 10
  # Lips and voice that are this close count as in sync.
  @in_step 80_000_000

  @doc "Returns the estimate; both lists must be in order of time. The same lists always give the same estimate."
  @spec estimate_shift([{Situ.Time.t(), %{term() => Mouth.t()}}], [{Situ.Time.t(), Voice.t()}]) ::
          t()
  def estimate_shift(mouths, voices) do
    voices = List.to_tuple(voices)
    windows = mouths |> cut_windows() |> thin_out() |> Enum.filter(&has_voice?(&1, voices))
    curve = for shift <- -@most..@most//@step, do: {shift, mean_agreement(windows, voices, shift)}
    {shift, top} = Enum.max_by(curve, fn {shift, value} -> {value, -abs(shift)} end)
    other = for {at, value} <- curve, abs(at - shift) > @peak, do: value
    confidence = if top > 0.0, do: (top - Enum.max(other)) / top, else: 0.0

    %__MODULE__{
      shift: shift,
      confidence: confidence |> max(0.0) |> Float.round(3),
      windows: length(windows)
    }
  end

  @doc """
  Returns whether audio and video are clearly out of sync: by at least 80 ms, with enough confidence.

      iex> Situ.Infer.LipSync.out_of_sync?(%Situ.Infer.LipSync{shift: -300_000_000, confidence: 0.7, windows: 40})
      true
      iex> Situ.Infer.LipSync.out_of_sync?(%Situ.Infer.LipSync{shift: -300_000_000, confidence: 0.2, windows: 40})
      false
  """
  @spec out_of_sync?(t()) :: boolean()
  def out_of_sync?(%__MODULE__{} = estimate) do
    abs(estimate.shift) >= @in_step and estimate.confidence >= @confident and
      estimate.windows >= @min_windows
  end

  # Splits the images into overlapping windows.
  defp cut_windows([]), do: []

  defp cut_windows([{start, _} | _] = mouths) do
    window = Enum.take_while(mouths, fn {time, _} -> time < start + @window end)
    [window | cut_windows(Enum.drop_while(mouths, fn {time, _} -> time < start + @hop end))]
  end

  defp thin_out(windows) do
    every = max(div(length(windows) + @most_windows - 1, @most_windows), 1)
    Enum.take_every(windows, every)
  end

  # The same windows are compared at every shift, so that all shifts are treated equally.
  defp has_voice?(window, voices) do
    heard = for {time, _} <- window, voice = nearest_voice(voices, time), do: voice.probability
    length(heard) >= @min_pictures and Enum.count(heard, &(&1 > @voiced)) * 2 >= length(heard)
  end

  defp mean_agreement([], _voices, _shift), do: 0.0

  defp mean_agreement(windows, voices, shift) do
    sum =
      for window <- windows, reduce: 0.0, do: (sum -> sum + best_agreement(window, voices, shift))

    sum / length(windows)
  end

  # The mouth with the best score is taken to be the speaker's.
  defp best_agreement(window, voices, shift) do
    heard =
      for {time, mouths} <- window,
          voice = nearest_voice(voices, time + shift),
          do: {mouths, voice}

    ids = heard |> Enum.flat_map(fn {mouths, _} -> Map.keys(mouths) end) |> Enum.uniq()

    ids
    |> Enum.map(fn id ->
      pairs =
        for {%{^id => mouth}, voice} <- heard,
            do: {mouth.opening, Moment.compress_loudness(voice.level)}

      Agreement.score_pairs(pairs, @min_pictures)
    end)
    |> Enum.reduce(0.0, &max/2)
  end

  # Returns the voice nearest to a time, or `nil` if there is none within 40 ms.
  defp nearest_voice(voices, time), do: nearest_voice(voices, time, 0, tuple_size(voices))

  defp nearest_voice(voices, time, low, high) when low < high do
    middle = div(low + high, 2)

    if elem(elem(voices, middle), 0) < time,
      do: nearest_voice(voices, time, middle + 1, high),
      else: nearest_voice(voices, time, low, middle)
  end

  defp nearest_voice(voices, time, at, _high) do
    for(i <- [at - 1, at], i >= 0 and i < tuple_size(voices), do: elem(voices, i))
    |> Enum.min_by(fn {heard, _} -> abs(heard - time) end, fn -> {nil, nil} end)
    |> case do
      {heard, voice} when is_integer(heard) and abs(heard - time) <= 40_000_000 -> voice
      _ -> nil
    end
  end
end
