defmodule Situ.Infer.SpeakerTurns do
  @schema [
    shortest: [
      type: :time_ns,
      default: 400_000_000,
      doc: "Whoever is the speaker for less than this, ns, has no turn of their own."
    ],
    nobody: [
      type: :time_ns,
      default: 1_000_000_000,
      doc:
        "A voice that goes on for so long, ns, while nobody in the picture speaks is somebody's outside of it: a turn."
    ]
  ]

  @moduledoc """
  Cuts speech where another face takes over without a pause, so that an utterance is one person's.

  Input `:heard` is `{speaking?, voice}`, both as `Situ.Infer.VoiceActivity` says, `:who` which faces speak
  (`Situ.Infer.who_speaks/3`). Output `:out` is `speaking?` again, with a `false` in the likeliest moment near each
  change of the speaker: the voice is hardly one there, or is quiet. `Situ.Infer.turns/2` joins what it needs:

      hear = Situ.via(sound, Situ.Infer.VoiceActivity)
      who = Situ.Infer.who_speaks(mouths, hear.voice)
      inputs = [sound: sound, speaking: Situ.Infer.turns(hear, who)]
      said = Situ.via(inputs, Situ.Infer.SpeechRecognizer, turns: true)

  A change is known after it: values are held back for 2.2 s. The output depends on the messages alone.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component,
    inputs: [
      heard: {:tuple, [:boolean, Situ.Infer.Voice]},
      who: {:map, :any, :boolean}
    ],
    outputs: [out: :boolean],
    options: @schema

  alias Situ.Infer.Voice

  # Lips tell of a change up to so long after it, and so long before it. That nobody's lips move any more is known
  # later.
  @late 700_000_000
  @soon 300_000_000
  @later 1_200_000_000
  # No piece of speech is cut shorter.
  @piece 300_000_000
  # Values that went out are remembered for so long: how long a voice has gone on.
  @memory 4_000_000_000

  defstruct [
              :opts,
              held: :queue.new(),
              heard_to: nil,
              past: [],
              asked: :queue.new(),
              seen_to: nil
            ] ++
              [runs: [], done: nil, cuts: []]

  @type t :: %__MODULE__{}

  @doc "Nothing heard or seen yet. Options as above."
  @spec new(keyword()) :: t()
  def new(opts \\ []), do: %__MODULE__{opts: opts |> Situ.Options.validate!(@schema) |> Map.new()}

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: Map.new(opts)}}

  @impl true
  def handle_message(:heard, %{data: {speaking?, voice}} = message, _context, state),
    do: hear(state, message.originating_time, speaking?, voice)

  def handle_message(:who, %{data: who} = message, _context, state),
    do: see(state, message.originating_time, who)

  @impl true
  def handle_closed(:heard, _time, _context, state), do: advance(%{state | heard_to: :infinity})
  def handle_closed(:who, _time, _context, state), do: see(state, :infinity, %{})

  @doc "Whether there is speech in the stretch of sound that ended at `time`, and the voice in it: what is certain now."
  @spec hear(t(), Situ.Time.t(), boolean(), Voice.t()) ::
          {[{:out, Situ.Time.t(), boolean()}], t()}
  def hear(%__MODULE__{} = state, time, speaking?, %Voice{} = voice),
    do: advance(%{state | held: :queue.in({time, speaking?, voice}, state.held), heard_to: time})

  @doc "Which faces speak at `time`, `:infinity` when there are no more pictures: what is certain now."
  @spec see(t(), Situ.Time.t() | :infinity, %{term() => boolean()}) ::
          {[{:out, Situ.Time.t(), boolean()}], t()}
  def see(%__MODULE__{} = state, time, who),
    do: advance(%{state | asked: :queue.in({time, speaker(who)}, state.asked)})

  # One picture after the other, each once the sound around it is known: so the order in which they come is no matter.
  defp advance(%{heard_to: nil} = state), do: {[], state}

  defp advance(state) do
    case :queue.peek(state.asked) do
      {:value, {time, who}} when time == :infinity or state.heard_to >= time + @soon ->
        state = %{state | asked: :queue.drop(state.asked), seen_to: time}
        {actions, state} = state |> run(time, who) |> cut() |> release([])
        {more, state} = advance(state)
        {actions ++ more, state}

      _ ->
        release(state, [])
    end
  end

  defp run(state, :infinity, _who), do: state

  defp run(%{runs: [{who, from, _} | runs]} = state, time, who),
    do: %{state | runs: [{who, from, time} | runs]}

  defp run(state, time, who) do
    recent = Enum.take_while(state.runs, fn {_, _, to} -> time - to < 10 * @memory end)
    %{state | runs: [{who, time, time} | recent]}
  end

  defp release(%{opts: opts} = state, out) do
    case :queue.peek(state.held) do
      {:value, {time, speaking?, voice}}
      when state.seen_to == :infinity or
             (state.seen_to != nil and state.seen_to > time + @later + opts.nobody) ->
        past = [
          {time, speaking?, voice} | Enum.take_while(state.past, &(time - elem(&1, 0) < @memory))
        ]

        out = [{:out, time, speaking? and time not in state.cuts} | out]
        release(%{state | held: :queue.drop(state.held), past: past}, out)

      _ ->
        {Enum.reverse(out), state}
    end
  end

  # Changes of the speaker that are certain and not looked at yet, oldest first.
  defp cut(%{seen_to: :infinity} = state), do: state

  defp cut(state) do
    for(
      {from, _, _} = change <- changes(turns(state)),
      state.done == nil or from > state.done,
      do: change
    )
    |> Enum.reduce(state, fn {from, _, _} = change, state ->
      case between(state, change) do
        nil -> %{state | done: from}
        time -> %{state | done: from, cuts: [time | Enum.take(state.cuts, 3)]}
      end
    end)
  end

  defp changes([{one, _, left}, {other, from, _} = next | turns]) when one != other,
    do: [{from, left, other} | changes([next | turns])]

  defp changes([_ | turns]), do: changes(turns)
  defp changes([]), do: []

  # Who was the speaker long enough, oldest first.
  defp turns(state) do
    for {who, from, to} = run <- Enum.reverse(state.runs), turn?(state, who, from, to), do: run
  end

  defp turn?(state, nil, from, to),
    do: to - max(from, unvoiced(state, from, to)) >= state.opts.nobody

  defp turn?(state, _face, from, to), do: to - from >= state.opts.shortest

  defp unvoiced(state, from, to) do
    for({time, false, _} <- heard(state), time > from, time <= to, do: time)
    |> Enum.max(fn -> from end)
  end

  # All that matters to the picture that is looked at.
  defp heard(state) do
    Enum.reverse(
      state.past,
      Enum.take_while(:queue.to_list(state.held), &(elem(&1, 0) <= state.seen_to + @soon))
    )
  end

  # The moment between two turns in one stretch of speech, `nil` where a pause is between them anyway.
  defp between(state, {from, left, who} = change) do
    {first, last} = if who == nil, do: {from - @later, from}, else: {from - @late, from + @soon}
    heard = heard(state)

    near =
      for {time, speaking?, _} <- heard, time >= min(first, left), time <= last, do: speaking?

    if near != [] and Enum.all?(near), do: best(state, change, heard, first, last)
  end

  defp best(state, {from, _, _}, heard, first, last) do
    ends = for {time, speaking?, _} <- heard, not speaking? or time in state.cuts, do: time
    free? = fn time -> Enum.all?(ends, &(abs(time - &1) >= @piece)) end
    waiting = with {:value, {time, _, _}} <- :queue.peek(state.held), do: time, else: (_ -> :none)

    places =
      for [{_, _, a}, {time, _, b}, {_, _, c}] <- Enum.chunk_every(heard, 3, 1, :discard),
          time >= max(first, waiting) and time <= last and free?.(time),
          do: {time, a.probability + b.probability + c.probability, a.level + b.level + c.level}

    loud = Enum.reduce(places, 1.0e-9, fn {_, _, level}, sum -> sum + level / length(places) end)

    places
    |> Enum.map(fn {time, p, level} ->
      {p / 3 + level / loud / 2 + abs(time - from) * 0.6e-9, time}
    end)
    |> Enum.min(fn -> {nil, nil} end)
    |> elem(1)
  end

  defp speaker(who),
    do: Enum.find_value(Enum.sort(who), fn {id, speaks?} -> speaks? && {:face, id} end)
end
