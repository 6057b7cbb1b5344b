defmodule Situ.Infer.ActiveSpeaker do
  @schema [
    lookahead: [
      type: :time_ns,
      default: 80_000_000,
      doc: "How far past a picture it waits before it decides on it: the delay of the answers."
    ],
    window: [
      type: :time_ns,
      default: 800_000_000,
      doc: "Over how long lips and sound are compared, up to the end of the lookahead."
    ],
    hold: [
      type: :time_ns,
      default: 200_000_000,
      doc: "A pause in the voice up to this long is part of the speech."
    ],
    on: [type: {:range, 0, 1}, default: 0.5, doc: "A voice begins at this probability."],
    off: [type: {:range, 0, 1}, default: 0.35, doc: "It goes on down to this one."],
    agreement: [
      type: {:range, 0, 1},
      default: 0.6,
      doc: "Correlation of lips and loudness that makes a face the speaker."
    ],
    margin: [
      type: {:range, 0, 1},
      default: 0.3,
      doc: "How much better another face must agree to take over from the speaker."
    ],
    movement: [
      type: :number,
      default: 0.02,
      doc:
        "Opening (see `Situ.Infer.Mouth`) that counts as movement: smaller ones are the detector's noise."
    ],
    pause: [
      type: :time_ns,
      default: 1_000_000_000,
      doc:
        "A speaker who pauses up to this long and moves when the voice comes back goes on speaking."
    ],
    still: [
      type: :time_ns,
      default: 400_000_000,
      doc:
        "How long a mouth may rest, ns, while a voice is heard, before its owner no longer counts as the speaker."
    ],
    doubt: [
      type: {:range, 0, 1},
      default: 0.25,
      doc:
        "A mouth that agrees less than this with a voice of 0.9 s and more, and is closed again and again while it " <>
          "is loud, is not the speaker's: somebody chews while another one talks. 0 leaves it the speaker's."
    ]
  ]

  @moduledoc """
  Decides who is speaking, from sound and lips.

  Input `:in` is `{mouths, voice}`: a map of face id to `Situ.Infer.Mouth` for every picture, and the
  `Situ.Infer.Voice` nearest to it, or `nil` where there is none. Output `:out` is a map of the same ids to booleans
  at the picture's time, `:lookahead` later.

      mouths
      |> Situ.join(voice, Situ.Reproducible.nearest(Situ.Time.ms(40), or_default: nil))
      |> Situ.via(Situ.Infer.ActiveSpeaker)

  At most one face speaks at a time:

    1. Nobody speaks while there is no voice (with hysteresis, and short pauses bridged).
    2. The face whose lips move **with** the loudness of the voice becomes the speaker: correlation over a window in
       which the mouth also must really move. A mouth that is merely open, or moves by itself, does not agree with the
       sound; a voice from outside of the picture agrees with nobody.
    3. Where none agrees clearly, the one face that was at rest and begins to move as the voice begins becomes the
       speaker.
    4. Once found, a speaker stays the speaker while the mouth moves and the voice goes on, unless another face agrees
       much better: within fluent speech lips and loudness agree less than at its beginning. But lips that go their
     own way for almost a second, closed where the voice is loud, are not the speaker's, however much they move.

  The decision depends only on the messages, never on their arrival: the same recording gives the same answers.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component,
    inputs: [
      in:
        {{:tuple, [{:map, :any, Situ.Infer.Mouth}, {:optional, Situ.Infer.Voice}]},
         optional: false}
    ],
    outputs: [out: {:map, :any, :boolean}],
    options: @schema

  alias Situ.Infer.ActiveSpeaker.{Agreement, Moment}

  # Loudness is compared compressed, as lips are: twice as loud is not twice as open.
  @compress 0.7
  # A mouth that moves less than this much cannot agree fully.
  @clear_movement 0.03
  # Speech moves the mouth at least this often.
  @syllable_ns 500_000_000

  # A mouth begins to move up to this long before or after its voice is heard.
  @onset_ns 400_000_000
  # Lips and voice are compared over so long before one is doubted: chance agreement over less is common.
  @doubt_ns 900_000_000
  @memory_ns 2_000_000_000

  defstruct [
    :opts,
    moments: [],
    undecided: [],
    voice?: false,
    heard: nil,
    since: nil,
    speaker: nil,
    moved: nil,
    before: nil,
    free: nil
  ]

  @type t :: %__MODULE__{}
  @type decision :: {Situ.Time.t(), %{term() => boolean()}}

  @doc "Nobody speaks yet. Options as above."
  @spec new(keyword()) :: t()
  def new(opts \\ []), do: %__MODULE__{opts: opts |> Situ.Options.validate!(@schema) |> Map.new()}

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: Map.new(opts)}}

  @impl true
  def handle_message(:in, %{data: {mouths, voice}} = message, _context, state) do
    {decisions, state} = push(state, message.originating_time, mouths, voice)
    {actions(decisions), state}
  end

  @impl true
  def handle_closed(:in, _time, _context, state) do
    {decisions, state} = close(state)
    {actions(decisions), state}
  end

  @impl true
  def describe(%{speaker: nil}), do: "nobody speaks"
  def describe(%{speaker: id}), do: "face #{inspect(id)} speaks"

  @doc "The next picture: decisions on those that lie `:lookahead` or more before it, oldest first."
  @spec push(t(), Situ.Time.t(), %{term() => Situ.Infer.Mouth.t()}, Situ.Infer.Voice.t() | nil) ::
          {[decision()], t()}
  def push(%__MODULE__{} = state, time, mouths, voice) do
    {decided, state} = decide(state, time)
    {moment, state} = listen(state, Moment.new(time, mouths, voice, @compress))
    moments = [moment | forget(state.moments, time, state.opts)]
    state = %{state | moments: moments, undecided: state.undecided ++ [moment]}
    {more, state} = decide(state, time + 1)
    {decided ++ more, state}
  end

  @doc "No more pictures: decisions on those that are left, by what there is."
  @spec close(t()) :: {[decision()], t()}
  def close(%__MODULE__{} = state), do: decide(state, :infinity)

  defp actions(decisions), do: for({time, speaking} <- decisions, do: {:out, time, speaking})

  # Decides all pictures whose lookahead ends before `now` (:infinity sorts after every number).
  defp decide(%{undecided: [moment | rest]} = state, now) do
    if moment.time + state.opts.lookahead < now do
      {decision, state} = judge(%{state | undecided: rest}, moment)
      {later, state} = decide(state, now)
      {[decision | later], state}
    else
      {[], state}
    end
  end

  defp decide(%{undecided: []} = state, _now), do: {[], state}

  # Hysteresis along the pictures: whether a voice is on at this one.
  defp listen(%{opts: opts} = state, moment) do
    heard = if moment.probability >= opts.off, do: moment.time, else: state.heard
    begun? = state.voice? or moment.probability >= opts.on
    on? = begun? and heard != nil and moment.time - heard <= opts.hold
    {%{moment | voice?: on?}, %{state | voice?: on?, heard: heard}}
  end

  defp forget(moments, now, opts) do
    oldest = now - max(opts.window, @memory_ns) - opts.lookahead - opts.hold
    Enum.take_while(moments, &(&1.time >= oldest))
  end

  defp judge(%{opts: opts} = state, moment) do
    until = moment.time + opts.lookahead
    seen = Enum.drop_while(state.moments, &(&1.time > until))

    state =
      if voice?(seen, moment.time - opts.hold, opts),
        do: state |> begin(moment.time) |> appoint(moment.time, seen, until),
        else: silent(state, moment.time)

    speaking = Map.new(moment.mouths, fn {id, _} -> {id, id == state.speaker} end)
    {{moment.time, speaking}, state}
  end

  defp begin(%{since: nil} = state, time), do: %{state | since: time, free: time}
  defp begin(state, _time), do: state

  defp silent(%{speaker: nil} = state, _time), do: %{state | since: nil}
  defp silent(state, time), do: %{state | since: nil, speaker: nil, before: {state.speaker, time}}

  # `seen` is newest first.
  defp voice?([%{voice?: false} | _], _since, _opts), do: false

  defp voice?(seen, since, opts) do
    seen |> Enum.take_while(&(&1.time >= since)) |> Enum.any?(&(&1.probability >= opts.on))
  end

  defp appoint(%{opts: opts} = state, time, seen, until) do
    window = Enum.take_while(seen, &(&1.time >= until - opts.window))
    {best, score, scores} = Agreement.best(window, @clear_movement)
    own = Map.get(scores, state.speaker, 0.0)

    cond do
      score > opts.agreement and takes_over?(best, state.speaker, score, own, opts) and
          not doubtful?(state, best, seen, until) ->
        appointed(state, best, time)

      state.speaker == nil ->
        unclear(state, time, seen, until)

      doubtful?(state, state.speaker, seen, until) ->
        %{state | speaker: nil}

      moving?(state.speaker, seen, until - @syllable_ns, opts.movement) ->
        %{state | moved: time}

      time - state.moved > opts.still ->
        %{state | speaker: nil, free: time}

      true ->
        state
    end
  end

  # A new speaker's lips are compared with the voice from when the one before gave way.
  defp appointed(%{speaker: nil} = state, id, time), do: %{state | speaker: id, moved: time}
  defp appointed(%{speaker: id} = state, id, time), do: %{state | moved: time}
  defp appointed(state, id, time), do: %{state | speaker: id, moved: time, free: time}

  # Whether this mouth contradicts the voice, ever since the voice was free to be its own.
  defp doubtful?(%{speaker: other}, id, _seen, _until) when other not in [nil, id], do: false

  defp doubtful?(%{opts: opts} = state, id, seen, until) do
    from = max(state.free, until - @memory_ns)
    window = Enum.take_while(seen, &(&1.time >= from))
    until - from >= @doubt_ns and Agreement.contradicts?(window, id, @clear_movement, opts.doubt)
  end

  # Nobody agrees clearly: who spoke a moment ago, or who alone began to move with the voice. A mouth that merely
  # stays open after its last word does not move.
  defp unclear(state, time, seen, until) do
    movers =
      for {id, _} <- hd(seen).mouths,
          range(id, seen, until - @syllable_ns, until) > state.opts.movement,
          not doubtful?(state, id, seen, until),
          do: id

    case {state.before, movers} do
      {{id, left}, [id]} when time - left <= state.opts.pause ->
        %{state | speaker: id, moved: time}

      {_, [id]} ->
        if began?(id, seen, state.since), do: appointed(state, id, time), else: state

      _ ->
        state
    end
  end

  # At rest before the voice, moving clearly around its beginning.
  defp began?(id, seen, since) do
    rest = range(id, seen, since - 2 * @onset_ns, since - div(@onset_ns, 2))
    start = range(id, seen, since - div(@onset_ns, 2), since + @onset_ns)
    rest < @clear_movement / 2 and start > @clear_movement
  end

  defp range(id, seen, from, to) do
    {low, high} =
      for(m <- seen, m.time >= from, m.time <= to, mouth = m.mouths[id], do: mouth.opening)
      |> Enum.min_max(fn -> {0.0, 0.0} end)

    high - low
  end

  defp takes_over?(_best, nil, _score, _own, _opts), do: true
  defp takes_over?(same, same, _score, _own, _opts), do: true
  defp takes_over?(_best, _speaker, score, own, opts), do: score > own + opts.margin

  defp moving?(id, seen, since, movement) do
    case for(m <- seen, m.time >= since, mouth = m.mouths[id], do: mouth) do
      [] ->
        false

      [latest | _] = mouths ->
        {low, high} = mouths |> Enum.map(& &1.opening) |> Enum.min_max()
        high - low > movement or latest.opening - latest.baseline > movement
    end
  end
end
