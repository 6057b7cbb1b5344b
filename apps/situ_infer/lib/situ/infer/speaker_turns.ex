defmodule Situ.Infer.SpeakerTurns do
  @moduledoc false
  # Cuts speech where another face takes over without a pause (`Situ.Infer.turns/3`). Input
  # `:heard` is `{speaking?, voice}`, `:who` contains which faces speak, and output `:out` is
  # `speaking?` again, with a `false` near each change of speaker. The output depends on the
  # messages alone.

  @schema [
    shortest: [
      type: :time_ns,
      default: 400_000_000,
      doc: "The shortest time, in ns, for which a face must be the speaker to get a turn."
    ],
    nobody: [
      type: :time_ns,
      default: 1_000_000_000,
      doc:
        "How long, in ns, a voice must last while no face in the image speaks to be a turn of somebody outside it."
    ]
  ]

  use Situ.Component,
    inputs: [
      heard: {:tuple, [:boolean, Situ.Infer.Voice]},
      who: {:map, :any, :boolean}
    ],
    outputs: [out: :boolean],
    options: @schema

  alias Situ.Infer.Voice

  # Lips show a change up to `@late` after it and `@soon` before it. It takes longer (`@later`) to know that nobody's
  # lips move any more.
  @late 700_000_000
  @soon 300_000_000
  @later 1_200_000_000
  # No segment of speech is cut shorter than this.
  @shortest_segment 300_000_000
  # Emitted values are kept for this long, to know how long a voice has lasted.
  @memory 4_000_000_000

  defstruct [
              :opts,
              queue: :queue.new(),
              voice_to: nil,
              history: [],
              images: :queue.new(),
              images_to: nil
            ] ++
              [runs: [], handled_to: nil, cuts: []]

  @type t :: %__MODULE__{}

  @doc "Returns the initial state, without audio or faces. See the options above."
  @spec new(keyword()) :: t()
  def new(opts \\ []), do: %__MODULE__{opts: opts |> Situ.Options.validate!(@schema) |> Map.new()}

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: Map.new(opts)}}

  @impl true
  def handle_message(:heard, %{data: {speaking?, voice}} = message, _context, state),
    do: push_speech(state, message.originating_time, speaking?, voice)

  def handle_message(:who, %{data: who} = message, _context, state),
    do: push_speakers(state, message.originating_time, who)

  @impl true
  def handle_closed(:heard, _time, _context, state),
    do: decide_speakers(%{state | voice_to: :infinity})

  def handle_closed(:who, _time, _context, state), do: push_speakers(state, :infinity, %{})

  @doc "Records whether the audio up to `time` is speech, and its voice. Returns the actions that are now certain."
  @spec push_speech(t(), Situ.Time.t(), boolean(), Voice.t()) ::
          {[{:out, Situ.Time.t(), boolean()}], t()}
  def push_speech(%__MODULE__{} = state, time, speaking?, %Voice{} = voice),
    do:
      decide_speakers(%{
        state
        | queue: :queue.in({time, speaking?, voice}, state.queue),
          voice_to: time
      })

  @doc "Records which faces speak at `time` (`:infinity` at the end). Returns the actions that are now certain."
  @spec push_speakers(t(), Situ.Time.t() | :infinity, %{term() => boolean()}) ::
          {[{:out, Situ.Time.t(), boolean()}], t()}
  def push_speakers(%__MODULE__{} = state, time, who),
    do: decide_speakers(%{state | images: :queue.in({time, speaking_face(who)}, state.images)})

  # Handles images one by one, each when the audio around it is known, so the order of arrival does not matter.
  defp decide_speakers(%{voice_to: nil} = state), do: {[], state}

  defp decide_speakers(state) do
    case :queue.peek(state.images) do
      {:value, {time, who}} when time == :infinity or state.voice_to >= time + @soon ->
        state = %{state | images: :queue.drop(state.images), images_to: time}
        {actions, state} = state |> extend_runs(time, who) |> cut_changes() |> release_values([])
        {more, state} = decide_speakers(state)
        {actions ++ more, state}

      _ ->
        release_values(state, [])
    end
  end

  defp extend_runs(state, :infinity, _who), do: state

  defp extend_runs(%{runs: [{who, from, _} | runs]} = state, time, who),
    do: %{state | runs: [{who, from, time} | runs]}

  defp extend_runs(state, time, who) do
    recent = Enum.take_while(state.runs, fn {_, _, to} -> time - to < 10 * @memory end)
    %{state | runs: [{who, time, time} | recent]}
  end

  defp release_values(%{opts: opts} = state, out) do
    case :queue.peek(state.queue) do
      {:value, {time, speaking?, voice}}
      when state.images_to == :infinity or
             (state.images_to != nil and state.images_to > time + @later + opts.nobody) ->
        history = [
          {time, speaking?, voice}
          | Enum.take_while(state.history, &(time - elem(&1, 0) < @memory))
        ]

        out = [{:out, time, speaking? and time not in state.cuts} | out]
        release_values(%{state | queue: :queue.drop(state.queue), history: history}, out)

      _ ->
        {Enum.reverse(out), state}
    end
  end

  # Handles the changes of speaker that are certain and not yet handled, oldest first.
  defp cut_changes(%{images_to: :infinity} = state), do: state

  defp cut_changes(state) do
    for(
      {from, _, _} = change <- list_changes(list_turns(state)),
      state.handled_to == nil or from > state.handled_to,
      do: change
    )
    |> Enum.reduce(state, fn {from, _, _} = change, state ->
      case find_cut(state, change) do
        nil -> %{state | handled_to: from}
        time -> %{state | handled_to: from, cuts: [time | Enum.take(state.cuts, 3)]}
      end
    end)
  end

  defp list_changes([{one, _, left}, {other, from, _} = next | turns]) when one != other,
    do: [{from, left, other} | list_changes([next | turns])]

  defp list_changes([_ | turns]), do: list_changes(turns)
  defp list_changes([]), do: []

  # Returns the runs in which somebody was the speaker for long enough, oldest first.
  defp list_turns(state) do
    for {who, from, to} = run <- Enum.reverse(state.runs),
        long_enough?(state, who, from, to),
        do: run
  end

  defp long_enough?(state, nil, from, to),
    do: to - max(from, last_unvoiced(state, from, to)) >= state.opts.nobody

  defp long_enough?(state, _face, from, to), do: to - from >= state.opts.shortest

  defp last_unvoiced(state, from, to) do
    for({time, false, _} <- audible_values(state), time > from, time <= to, do: time)
    |> Enum.max(fn -> from end)
  end

  # Returns all values that are relevant to the current image.
  defp audible_values(state) do
    Enum.reverse(
      state.history,
      Enum.take_while(:queue.to_list(state.queue), &(elem(&1, 0) <= state.images_to + @soon))
    )
  end

  # Returns the moment of the cut between two turns, or `nil` if there is a pause between them anyway.
  defp find_cut(state, {from, left, who} = change) do
    {first, last} = if who == nil, do: {from - @later, from}, else: {from - @late, from + @soon}
    heard = audible_values(state)

    values =
      for {time, speaking?, _} <- heard, time >= min(first, left), time <= last, do: speaking?

    if values != [] and Enum.all?(values),
      do: quietest_moment(state, change, heard, first, last)
  end

  defp quietest_moment(state, {from, _, _}, heard, first, last) do
    ends = for {time, speaking?, _} <- heard, not speaking? or time in state.cuts, do: time
    far_from_cuts? = fn time -> Enum.all?(ends, &(abs(time - &1) >= @shortest_segment)) end

    waiting =
      with {:value, {time, _, _}} <- :queue.peek(state.queue), do: time, else: (_ -> :none)

    moments =
      for [{_, _, a}, {time, _, b}, {_, _, c}] <- Enum.chunk_every(heard, 3, 1, :discard),
          time >= max(first, waiting) and time <= last and far_from_cuts?.(time),
          do: {time, a.probability + b.probability + c.probability, a.level + b.level + c.level}

    loud =
      Enum.reduce(moments, 1.0e-9, fn {_, _, level}, sum -> sum + level / length(moments) end)

    moments
    |> Enum.map(fn {time, p, level} ->
      {p / 3 + level / loud / 2 + abs(time - from) * 0.6e-9, time}
    end)
    |> Enum.min(fn -> {nil, nil} end)
    |> elem(1)
  end

  defp speaking_face(who),
    do: Enum.find_value(Enum.sort(who), fn {id, speaks?} -> speaks? && {:face, id} end)
end
