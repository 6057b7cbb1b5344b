defmodule Situ.Infer.VoiceGate do
  @schema [
    on: [type: {:range, 0, 1}, default: 0.5, doc: "Speech begins at this probability."],
    off: [type: {:range, 0, 1}, default: 0.35, doc: "Speech goes on down to this one."],
    min_speech: [
      type: :time_ns,
      default: 96_000_000,
      doc: "Shorter speech is none, in nanoseconds."
    ],
    min_silence: [
      type: :time_ns,
      default: 250_000_000,
      doc: "A shorter pause is part of the speech, in nanoseconds."
    ],
    decide: [
      type: {:in, [:exact, :at_once]},
      default: :exact,
      doc:
        "`:exact` holds a value back while it is not sure (never longer than the two times " <>
          "above); `:at_once` says what it believes."
    ]
  ]

  @moduledoc """
  Turns the probability of speech into yes or no, with hysteresis, and into segments. A pure state machine.

  Two thresholds keep it from flickering; short bursts are no speech and short pauses no silence. Whether a pause is
  short is known only after it, so with `decide: :exact` the values of a pause are held back until it ends or grows
  too long: what comes out then has no tail, and is the same live and from a file.

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

  ## Options

  #{Situ.Options.docs(@schema)}
  """

  defstruct [:opts, open: nil, last: nil, sure?: false, held: []]

  @type t :: %__MODULE__{
          opts: map(),
          open: Situ.Time.t() | nil,
          last: Situ.Time.t() | nil,
          sure?: boolean(),
          held: [Situ.Time.t()]
        }
  @type event ::
          {Situ.Time.t(), boolean()} | {:segment, start :: Situ.Time.t(), stop :: Situ.Time.t()}

  @doc "The options' schema, for components that pass them on."
  @spec schema() :: Situ.Options.schema()
  def schema, do: @schema

  @doc "A closed gate."
  @spec new(keyword()) :: t()
  def new(opts \\ []), do: %__MODULE__{opts: Map.new(Situ.Options.validate!(opts, @schema))}

  @doc """
  The span of `length` ns that ended at `time` is speech with this probability: what is decided by it, in the order of
  time, and a segment when one is over.
  """
  @spec push(t(), Situ.Time.t(), Situ.Time.duration(), float()) :: {[event()], t()}
  def push(%__MODULE__{open: nil} = gate, time, length, p) do
    if p >= gate.opts.on,
      do: voiced(%{gate | open: time - length}, time),
      else: {[{time, false}], gate}
  end

  def push(gate, time, _length, p) do
    cond do
      p >= gate.opts.off -> voiced(gate, time)
      time - gate.last >= gate.opts.min_silence -> over(gate, [time])
      true -> unvoiced(gate, time)
    end
  end

  @doc "The sound is over: what was held back, and the last segment."
  @spec close(t()) :: {[event()], t()}
  def close(%__MODULE__{open: nil} = gate), do: {[], gate}
  def close(gate), do: over(gate, [])

  @doc "Whether speech is going on (or a pause in it)."
  @spec open?(t()) :: boolean()
  def open?(%__MODULE__{} = gate), do: gate.open != nil and gate.sure?

  defp voiced(gate, time) do
    sure? = gate.sure? or time - gate.open >= gate.opts.min_speech
    gate = %{gate | last: time, sure?: sure?}

    cond do
      sure? -> {values([time | gate.held], true), %{gate | held: []}}
      gate.opts.decide == :at_once -> {[{time, false}], gate}
      true -> {[], %{gate | held: [time | gate.held]}}
    end
  end

  defp unvoiced(%{opts: %{decide: :at_once}} = gate, time), do: {[{time, gate.sure?}], gate}
  defp unvoiced(gate, time), do: {[], %{gate | held: [time | gate.held]}}

  defp over(gate, now) do
    segment = if gate.sure?, do: [{:segment, gate.open, gate.last}], else: []

    {values(now ++ gate.held, false) ++ segment,
     %{gate | open: nil, last: nil, sure?: false, held: []}}
  end

  defp values(times, value), do: times |> Enum.reverse() |> Enum.map(&{&1, value})
end
