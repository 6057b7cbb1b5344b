defmodule Situ.Infer.ActiveSpeaker do
  @moduledoc """
  Decides which face is speaking, from audio and lip movement.

  Input `:in` is `{mouths, voice}`: for every image, a map from face id to mouth, from `Situ.Infer.MouthShape`, and the
  nearest message of `Situ.Infer.voice/2` (or `nil`). Output `:out` is a map from the same ids to booleans. It has the
  image's time and is emitted `:lookahead` later.

      mouths
      |> Situ.join(voice, Situ.Reproducible.nearest(Situ.Time.ms(40), or_default: nil))
      |> Situ.via(Situ.Infer.ActiveSpeaker)

  At most one face speaks at a time:

    1. Without a voice, nobody is speaking. The voice has hysteresis, and short pauses are bridged.
    2. The face whose lips move **with** the loudness of the voice becomes the speaker. The measure is the correlation
       over a window in which the mouth must also clearly move. A mouth that is merely open, or that moves
       independently, does not correlate with the audio, and a voice from outside the image correlates with no face.
    3. If no face correlates clearly, the only face that was at rest and starts to move as the voice starts becomes the
       speaker.
    4. A speaker remains the speaker while the mouth moves and the voice continues, unless another face scores much
       higher, because lips and loudness correlate less within fluent speech than at its start. But lips that contradict
       the voice for almost a second (closed while it is loud) are not the speaker's, however much they move.

  The decision depends only on the messages and not on when they arrive, so a recording always gives the same result.
  """

  @schema [
    lookahead: [
      type: :time_ns,
      default: 80_000_000,
      doc: "How long to wait after an image before the decision; this is the delay of the output."
    ],
    window: [
      type: :time_ns,
      default: 800_000_000,
      doc:
        "The window over which lips and audio are compared; it ends at the end of the lookahead."
    ],
    hold: [
      type: :time_ns,
      default: 200_000_000,
      doc: "The longest pause in the voice that still counts as speech."
    ],
    on: [type: {:range, 0, 1}, default: 0.5, doc: "A voice begins at this probability."],
    off: [type: {:range, 0, 1}, default: 0.35, doc: "A voice ends below this probability."],
    agreement: [
      type: {:range, 0, 1},
      default: 0.6,
      doc: "The correlation between lips and loudness that makes a face the speaker."
    ],
    margin: [
      type: {:range, 0, 1},
      default: 0.3,
      doc: "How much higher another face must score to take over from the speaker."
    ],
    movement: [
      type: :number,
      default: 0.02,
      doc:
        "The change in opening (see `Situ.Infer.MouthShape`) that counts as movement; smaller ones are noise."
    ],
    pause: [
      type: :time_ns,
      default: 1_000_000_000,
      doc:
        "The longest pause after which a speaker whose mouth moves as the voice returns is still the speaker."
    ],
    still: [
      type: :time_ns,
      default: 400_000_000,
      doc:
        "How long a mouth may rest while a voice is heard, in ns, before its face stops counting as the speaker."
    ],
    doubt: [
      type: {:range, 0, 1},
      default: 0.25,
      doc:
        "A mouth that scores less than this with a voice of at least 0.9 s, and is often closed while the voice is " <>
          "loud, is not the speaker's (a person chewing while someone else talks, for example). 0 disables this check."
    ]
  ]

  use Situ.Component,
    inputs: [
      in:
        {{:tuple, [{:map, :any, Situ.Infer.Mouth}, {:optional, Situ.Infer.Voice}]},
         optional: false}
    ],
    outputs: [out: {:map, :any, :boolean}],
    options: @schema

  alias Situ.Infer.ActiveSpeaker.{Agreement, Moment}

  # A threshold on the opening of the mouth would make a silent, smiling face the speaker. The
  # numbers were chosen on nine clips, where each has a wide margin on both sides, and checked on
  # six others. Weak spots: pauses of more than 0.3 s within speech count as silence, and two
  # faces that start to move together are told apart by their correlation only.

  @clear_movement Agreement.clear_movement()
  # During speech, the mouth moves at least once in this time.
  @syllable_ns 500_000_000

  # A mouth starts to move at most this long before or after its voice is heard.
  @onset_ns 400_000_000
  # Lips and voice are compared for this long before a speaker is doubted, since shorter matches are often chance.
  @doubt_ns 900_000_000
  @memory_ns 2_000_000_000

  defstruct [
    :opts,
    moments: [],
    undecided: [],
    voice?: false,
    last_voice: nil,
    speech_start: nil,
    speaker: nil,
    moved_at: nil,
    last_speaker: nil,
    free_from: nil
  ]

  @type t :: %__MODULE__{}
  @type decision :: {Situ.Time.t(), %{term() => boolean()}}

  @doc "Returns the initial state, in which nobody speaks. See the options above."
  @spec new(keyword()) :: t()
  def new(opts \\ []), do: %__MODULE__{opts: opts |> Situ.Options.validate!(@schema) |> Map.new()}

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: Map.new(opts)}}

  @impl true
  def handle_message(:in, %{data: {mouths, voice}} = message, _context, state) do
    {decisions, state} = push(state, message.originating_time, mouths, voice)
    {to_actions(decisions), state}
  end

  @impl true
  def handle_closed(:in, _time, _context, state) do
    {decisions, state} = close(state)
    {to_actions(decisions), state}
  end

  @impl true
  def describe(%{speaker: nil}), do: "nobody speaks"
  def describe(%{speaker: id}), do: "face #{inspect(id)} speaks"

  @doc "Adds the next image, and returns the decisions on images at least `:lookahead` older, oldest first."
  @spec push(t(), Situ.Time.t(), %{term() => Situ.Infer.Mouth.t()}, Situ.Infer.Voice.t() | nil) ::
          {[decision()], t()}
  def push(%__MODULE__{} = state, time, mouths, voice) do
    {decided, state} = decide_moments(state, time)
    {moment, state} = apply_hysteresis(state, Moment.new(time, mouths, voice))
    moments = [moment | drop_old_moments(state.moments, time, state.opts)]
    state = %{state | moments: moments, undecided: state.undecided ++ [moment]}
    {more, state} = decide_moments(state, time + 1)
    {decided ++ more, state}
  end

  @doc "Ends the input, and returns the decisions on the remaining images."
  @spec close(t()) :: {[decision()], t()}
  def close(%__MODULE__{} = state), do: decide_moments(state, :infinity)

  defp to_actions(decisions), do: for({time, speaking} <- decisions, do: {:out, time, speaking})

  # Decides all images whose lookahead ends before `now` (:infinity sorts after every number).
  defp decide_moments(%{undecided: [moment | rest]} = state, now) do
    if moment.time + state.opts.lookahead < now do
      {decision, state} = decide_moment(%{state | undecided: rest}, moment)
      {later, state} = decide_moments(state, now)
      {[decision | later], state}
    else
      {[], state}
    end
  end

  defp decide_moments(%{undecided: []} = state, _now), do: {[], state}

  # Applies the hysteresis that decides whether a voice is active at this image.
  defp apply_hysteresis(%{opts: opts} = state, moment) do
    last_voice = if moment.probability >= opts.off, do: moment.time, else: state.last_voice
    begun? = state.voice? or moment.probability >= opts.on
    on? = begun? and last_voice != nil and moment.time - last_voice <= opts.hold
    {%{moment | voice?: on?}, %{state | voice?: on?, last_voice: last_voice}}
  end

  defp drop_old_moments(moments, now, opts) do
    oldest = now - max(opts.window, @memory_ns) - opts.lookahead - opts.hold
    Enum.take_while(moments, &(&1.time >= oldest))
  end

  defp decide_moment(%{opts: opts} = state, moment) do
    until = moment.time + opts.lookahead
    seen = Enum.drop_while(state.moments, &(&1.time > until))

    state =
      if voice_active?(seen, moment.time - opts.hold, opts),
        do: state |> start_speech(moment.time) |> update_speaker(moment.time, seen, until),
        else: end_speech(state, moment.time)

    speaking = Map.new(moment.mouths, fn {id, _} -> {id, id == state.speaker} end)
    {{moment.time, speaking}, state}
  end

  defp start_speech(%{speech_start: nil} = state, time),
    do: %{state | speech_start: time, free_from: time}

  defp start_speech(state, _time), do: state

  defp end_speech(%{speaker: nil} = state, _time), do: %{state | speech_start: nil}

  defp end_speech(state, time),
    do: %{state | speech_start: nil, speaker: nil, last_speaker: {state.speaker, time}}

  # `seen` is newest first.
  defp voice_active?([%{voice?: false} | _], _since, _opts), do: false

  defp voice_active?(seen, since, opts) do
    seen |> Enum.take_while(&(&1.time >= since)) |> Enum.any?(&(&1.probability >= opts.on))
  end

  defp update_speaker(%{opts: opts} = state, time, seen, until) do
    window = Enum.take_while(seen, &(&1.time >= until - opts.window))
    {best, score, scores} = Agreement.best_face(window)
    own = Map.get(scores, state.speaker, 0.0)

    cond do
      score > opts.agreement and takes_over?(best, state.speaker, score, own, opts) and
          not contradicts_voice?(state, best, seen, until) ->
        assign_speaker(state, best, time)

      state.speaker == nil ->
        appoint_by_onset(state, time, seen, until)

      contradicts_voice?(state, state.speaker, seen, until) ->
        %{state | speaker: nil}

      mouth_moving?(state.speaker, seen, until - @syllable_ns, opts.movement) ->
        %{state | moved_at: time}

      time - state.moved_at > opts.still ->
        %{state | speaker: nil, free_from: time}

      true ->
        state
    end
  end

  # A new speaker's lips are compared with the voice only from the time when the previous speaker stopped.
  defp assign_speaker(%{speaker: nil} = state, id, time),
    do: %{state | speaker: id, moved_at: time}

  defp assign_speaker(%{speaker: id} = state, id, time), do: %{state | moved_at: time}

  defp assign_speaker(state, id, time),
    do: %{state | speaker: id, moved_at: time, free_from: time}

  # Returns whether this mouth contradicts the voice since the previous speaker stopped.
  defp contradicts_voice?(%{speaker: other}, id, _seen, _until) when other not in [nil, id],
    do: false

  defp contradicts_voice?(%{opts: opts} = state, id, seen, until) do
    from = max(state.free_from, until - @memory_ns)
    window = Enum.take_while(seen, &(&1.time >= from))

    until - from >= @doubt_ns and
      Agreement.contradicts_voice?(window, id, opts.doubt)
  end

  # No face scores clearly, so the last speaker, or the only face that started to move with the voice, is chosen. A
  # mouth that merely stays open after its last word does not move.
  defp appoint_by_onset(state, time, seen, until) do
    movers =
      for {id, _} <- hd(seen).mouths,
          opening_range(id, seen, until - @syllable_ns, until) > state.opts.movement,
          not contradicts_voice?(state, id, seen, until),
          do: id

    case {state.last_speaker, movers} do
      {{id, left}, [id]} when time - left <= state.opts.pause ->
        %{state | speaker: id, moved_at: time}

      {_, [id]} ->
        if began_with_voice?(id, seen, state.speech_start),
          do: assign_speaker(state, id, time),
          else: state

      _ ->
        state
    end
  end

  # The mouth was at rest before the voice and moves clearly around its start.
  defp began_with_voice?(id, seen, since) do
    rest = opening_range(id, seen, since - 2 * @onset_ns, since - div(@onset_ns, 2))
    start = opening_range(id, seen, since - div(@onset_ns, 2), since + @onset_ns)
    rest < @clear_movement / 2 and start > @clear_movement
  end

  defp opening_range(id, seen, from, to) do
    {low, high} =
      for(m <- seen, m.time >= from, m.time <= to, mouth = m.mouths[id], do: mouth.opening)
      |> Enum.min_max(fn -> {0.0, 0.0} end)

    high - low
  end

  defp takes_over?(_best, nil, _score, _own, _opts), do: true
  defp takes_over?(same, same, _score, _own, _opts), do: true
  defp takes_over?(_best, _speaker, score, own, opts), do: score > own + opts.margin

  defp mouth_moving?(id, seen, since, movement) do
    case for(m <- seen, m.time >= since, mouth = m.mouths[id], do: mouth) do
      [] ->
        false

      [latest | _] = mouths ->
        {low, high} = mouths |> Enum.map(& &1.opening) |> Enum.min_max()
        high - low > movement or latest.opening - latest.baseline > movement
    end
  end
end
