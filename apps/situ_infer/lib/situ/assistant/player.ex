defmodule Situ.Assistant.Player do
  @schema [
    piece: [type: :pos_integer, default: 20_000_000, doc: "Length of one piece, ns."],
    ahead: [
      type: :time_ns,
      default: 80_000_000,
      doc:
        "How much sound is given to the speaker before its time, ns: what an interruption cannot take back."
    ]
  ]

  @moduledoc """
  Plays sounds one after the other in real time, in small pieces, and falls silent when it is told to.

  Inputs `:in` and `:answers` are whole sounds (all of one format), as `Situ.Infer.SpeechSynthesizer` makes them with
  `stamp: :text`. A message on `:stop` ends the sound that is played and forgets those whose texts are older. Output
  `:out` is the pieces, each at its end; `:speaking` says whether there is sound, at each change.

  When the inputs end, what is left comes at once.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component,
    inputs: [
      in: Situ.AudioBuffer,
      answers: {Situ.AudioBuffer, optional: true},
      stop: {:any, optional: true}
    ],
    outputs: [out: Situ.AudioBuffer, speaking: :boolean],
    options: @schema

  alias Situ.{AudioBuffer, AudioFormat}

  defstruct [:opts, waiting: [], head: nil, told: nil, speaking: false, timer: nil]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: Map.new(opts)}}

  @impl true
  def handle_message(:stop, %{originating_time: time}, context, state) do
    # An answer decided after the user spoke replies to that speech, so it is still played.
    waiting = Enum.filter(state.waiting, fn {decided, _} -> decided >= time end)
    step(%{state | waiting: waiting}, context.now)
  end

  def handle_message(_sound, %{data: sound, originating_time: time}, context, state) do
    sounds = state.waiting ++ [{time, pieces(sound, state.opts.piece)}]
    step(%{state | waiting: sounds}, context.now)
  end

  defp pieces(sound, length) do
    frames = max(AudioFormat.ns_to_frames(sound.format, length), 1)
    total = AudioBuffer.frames(sound)

    for from <- 0..(total - 1)//frames,
        do: AudioBuffer.slice(sound, from, min(frames, total - from))
  end

  @impl true
  def handle_info({:timer, :play}, context, state), do: step(%{state | timer: nil}, context.now)
  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_closed(input, _time, context, state) when input in [:in, :answers],
    do: play(state, [], context.now, :all)

  def handle_closed(:stop, _time, _context, state), do: {[], state}

  @impl true
  def describe(state), do: "#{length(state.waiting)} sounds wait"

  defp step(state, now), do: play(state, [], now, :due)

  # The pieces that are due, then a look at the clock when the next one is.
  defp play(%{waiting: [{_, []} | rest]} = state, actions, now, which),
    do: play(%{state | waiting: rest}, actions, now, which)

  defp play(%{waiting: []} = state, actions, now, which) do
    cond do
      not state.speaking -> {Enum.reverse(actions), state}
      which == :due and now < silent_at(state) -> wake(state, actions, silent_at(state))
      true -> state |> speaking(actions, false, max(now, state.head)) |> done()
    end
  end

  defp play(%{waiting: [{time, [piece | pieces]} | rest]} = state, actions, now, which) do
    head = max(state.head || now - state.opts.ahead, now - state.opts.ahead)
    head = if which == :all, do: state.head || now, else: head
    ends = head + AudioBuffer.duration(piece)

    if which == :all or ends <= now do
      {actions, state} = speaking(state, actions, true, now)
      state = %{state | waiting: [{time, pieces} | rest], head: ends}
      play(state, [{:out, ends, piece} | actions], now, which)
    else
      wake(state, actions, ends)
    end
  end

  # The sound emitted ahead is still being played.
  defp silent_at(state), do: state.head + state.opts.ahead
  defp done({actions, state}), do: {Enum.reverse(actions), state}

  defp speaking(%{speaking: same} = state, actions, same, _at), do: {actions, state}

  defp speaking(state, actions, now?, at) do
    at = if state.told, do: max(at, state.told + 1), else: at
    {[{:speaking, at, now?} | actions], %{state | speaking: now?, told: at}}
  end

  defp wake(%{timer: due} = state, actions, at) when due != nil and due <= at,
    do: {Enum.reverse(actions), state}

  defp wake(state, actions, at),
    do: {Enum.reverse([{:timer, :play, at} | actions]), %{state | timer: at}}
end
