defmodule Situ.Assistant.Player do
  @moduledoc false
  # Plays audio buffers one after the other in real time, in small chunks, and stops on request.
  #
  # Inputs `:in` and `:answers` contain complete audio buffers (all of one format), as
  # `Situ.Infer.SpeechSynthesizer` emits them with `stamp: :text`. A message on `:stop` ends the
  # current audio and discards queued audio whose text is older. Output `:out` emits the chunks,
  # each at its end; `:speaking` emits whether audio is playing, at each change.
  #
  # When the inputs end, the remaining audio is emitted immediately.

  @schema [
    chunk: [type: :pos_integer, default: 20_000_000, doc: "Length of one chunk, ns."],
    ahead: [
      type: :time_ns,
      default: 80_000_000,
      doc:
        "How far ahead of playback audio is emitted, ns; an interruption cannot stop this much audio."
    ]
  ]

  use Situ.Component,
    inputs: [
      in: Situ.AudioBuffer,
      answers: {Situ.AudioBuffer, optional: true},
      stop: {:any, optional: true}
    ],
    outputs: [out: Situ.AudioBuffer, speaking: :boolean],
    options: @schema

  alias Situ.{AudioBuffer, AudioFormat}

  defstruct [:opts, waiting: [], emitted_to: nil, changed_at: nil, speaking?: false, timer: nil]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: Map.new(opts)}}

  @impl true
  def handle_message(:stop, %{originating_time: time}, context, state) do
    # A reply decided after the user spoke responds to that speech, so it is still played.
    waiting = Enum.filter(state.waiting, fn {decided, _} -> decided >= time end)
    play_due(%{state | waiting: waiting}, context.now)
  end

  def handle_message(_sound, %{data: sound, originating_time: time}, context, state) do
    sounds = state.waiting ++ [{time, split_audio(sound, state.opts.chunk)}]
    play_due(%{state | waiting: sounds}, context.now)
  end

  defp split_audio(sound, length) do
    frames = max(AudioFormat.ns_to_frames(sound.format, length), 1)
    total = AudioBuffer.frame_count(sound)

    for from <- 0..(total - 1)//frames,
        do: AudioBuffer.slice_frames(sound, from, min(frames, total - from))
  end

  @impl true
  def handle_info({:timer, :play}, context, state),
    do: play_due(%{state | timer: nil}, context.now)

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_closed(input, _time, context, state) when input in [:in, :answers],
    do: play_chunks(state, [], context.now, :all)

  def handle_closed(:stop, _time, _context, state), do: {[], state}

  @impl true
  def describe(state), do: "#{length(state.waiting)} audio buffers waiting"

  defp play_due(state, now), do: play_chunks(state, [], now, :due)

  # Emits the chunks that are due, then sets a timer for the next one.
  defp play_chunks(%{waiting: [{_, []} | rest]} = state, actions, now, which),
    do: play_chunks(%{state | waiting: rest}, actions, now, which)

  defp play_chunks(%{waiting: []} = state, actions, now, which) do
    cond do
      not state.speaking? ->
        {Enum.reverse(actions), state}

      which == :due and now < silent_at(state) ->
        schedule_play(state, actions, silent_at(state))

      true ->
        state |> emit_speaking(actions, false, max(now, state.emitted_to)) |> finish_actions()
    end
  end

  defp play_chunks(%{waiting: [{time, [chunk | chunks]} | rest]} = state, actions, now, which) do
    emitted_to = max(state.emitted_to || now - state.opts.ahead, now - state.opts.ahead)
    emitted_to = if which == :all, do: state.emitted_to || now, else: emitted_to
    ends = emitted_to + AudioBuffer.duration_ns(chunk)

    if which == :all or ends <= now do
      {actions, state} = emit_speaking(state, actions, true, now)
      state = %{state | waiting: [{time, chunks} | rest], emitted_to: ends}
      play_chunks(state, [{:out, ends, chunk} | actions], now, which)
    else
      schedule_play(state, actions, ends)
    end
  end

  # Audio that was emitted ahead of time is still playing.
  defp silent_at(state), do: state.emitted_to + state.opts.ahead
  defp finish_actions({actions, state}), do: {Enum.reverse(actions), state}

  defp emit_speaking(%{speaking?: same} = state, actions, same, _at), do: {actions, state}

  defp emit_speaking(state, actions, now?, at) do
    at = if state.changed_at, do: max(at, state.changed_at + 1), else: at
    {[{:speaking, at, now?} | actions], %{state | speaking?: now?, changed_at: at}}
  end

  defp schedule_play(%{timer: due} = state, actions, at) when due != nil and due <= at,
    do: {Enum.reverse(actions), state}

  defp schedule_play(state, actions, at),
    do: {Enum.reverse([{:timer, :play, at} | actions]), %{state | timer: at}}
end
