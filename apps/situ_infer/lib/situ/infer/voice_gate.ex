defmodule Situ.Infer.VoiceGate do
  @moduledoc false
  # Converts the probability of speech to a boolean, with hysteresis, and to segments. Pure.
  # `Situ.Infer.VoiceActivity` describes the behaviour. With `decide: :exact`, values are held back
  # until the pause ends or becomes too long, so the output has no trailing speech.

  @schema [
    on: [type: {:range, 0, 1}, default: 0.5, doc: "Speech starts at this probability."],
    off: [type: {:range, 0, 1}, default: 0.35, doc: "Speech ends below this probability."],
    min_speech: [
      type: :time_ns,
      default: 96_000_000,
      doc: "Shorter speech is ignored, in ns."
    ],
    min_silence: [
      type: :time_ns,
      default: 250_000_000,
      doc: "A shorter pause is part of the speech, in ns."
    ],
    decide: [
      type: {:in, [:exact, :at_once]},
      default: :exact,
      doc:
        "`:exact` holds a value back until it is certain (never longer than the two times above); " <>
          "`:at_once` emits the current estimate without delay."
    ]
  ]

  defstruct [:opts, open: nil, last: nil, sure?: false, pending: []]

  @type t :: %__MODULE__{
          opts: map(),
          open: Situ.Time.t() | nil,
          last: Situ.Time.t() | nil,
          sure?: boolean(),
          pending: [Situ.Time.t()]
        }
  @type event ::
          {Situ.Time.t(), boolean()} | {:segment, start :: Situ.Time.t(), stop :: Situ.Time.t()}

  @doc "Returns the schema of the options, for components that pass them on."
  @spec schema() :: Situ.Options.schema()
  def schema, do: @schema

  @doc """
  Returns a closed gate.

      iex> gate = Situ.Infer.VoiceGate.new(min_speech: 0, min_silence: 20)
      iex> {out, gate} = Situ.Infer.VoiceGate.push(gate, 10, 10, 0.9)
      iex> out
      [{10, true}]
      iex> {out, gate} = Situ.Infer.VoiceGate.push(gate, 20, 10, 0.1)
      iex> out
      []
      iex> {out, gate} = Situ.Infer.VoiceGate.push(gate, 30, 10, 0.1)
      iex> out
      [{20, false}, {30, false}, {:segment, 0, 10}]
      iex> Situ.Infer.VoiceGate.close(gate) |> elem(0)
      []
  """
  @spec new(keyword()) :: t()
  def new(opts \\ []), do: %__MODULE__{opts: Map.new(Situ.Options.validate!(opts, @schema))}

  @doc """
  Adds the probability of speech in the span of `length` ns that ended at `time`. Returns the values that are now
  decided, in order of time, and a segment when one ends.
  """
  @spec push(t(), Situ.Time.t(), Situ.Time.duration(), float()) :: {[event()], t()}
  def push(%__MODULE__{open: nil} = gate, time, length, p) do
    if p >= gate.opts.on,
      do: push_voiced(%{gate | open: time - length}, time),
      else: {[{time, false}], gate}
  end

  def push(gate, time, _length, p) do
    cond do
      p >= gate.opts.off -> push_voiced(gate, time)
      time - gate.last >= gate.opts.min_silence -> close_segment(gate, [time])
      true -> push_unvoiced(gate, time)
    end
  end

  @doc "Ends the input, and returns the values held back and the last segment."
  @spec close(t()) :: {[event()], t()}
  def close(%__MODULE__{open: nil} = gate), do: {[], gate}
  def close(gate), do: close_segment(gate, [])

  @doc "Returns whether speech (or a short pause in it) is in progress."
  @spec speech_open?(t()) :: boolean()
  def speech_open?(%__MODULE__{} = gate), do: gate.open != nil and gate.sure?

  defp push_voiced(gate, time) do
    sure? = gate.sure? or time - gate.open >= gate.opts.min_speech
    gate = %{gate | last: time, sure?: sure?}

    cond do
      sure? -> {stamp_values([time | gate.pending], true), %{gate | pending: []}}
      gate.opts.decide == :at_once -> {[{time, false}], gate}
      true -> {[], %{gate | pending: [time | gate.pending]}}
    end
  end

  defp push_unvoiced(%{opts: %{decide: :at_once}} = gate, time), do: {[{time, gate.sure?}], gate}
  defp push_unvoiced(gate, time), do: {[], %{gate | pending: [time | gate.pending]}}

  defp close_segment(gate, now) do
    segment = if gate.sure?, do: [{:segment, gate.open, gate.last}], else: []

    {stamp_values(now ++ gate.pending, false) ++ segment,
     %{gate | open: nil, last: nil, sure?: false, pending: []}}
  end

  defp stamp_values(times, value), do: times |> Enum.reverse() |> Enum.map(&{&1, value})
end
