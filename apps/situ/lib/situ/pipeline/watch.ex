defmodule Situ.Pipeline.Watch do
  @moduledoc false
  # What does not end when everything is to end: named, and killed.
  alias Situ.Error
  alias Situ.Pipeline.{Life, Notice}
  alias Situ.Stage.Counters

  # No counter moved for the whole stop timeout: what still owes an answer is stuck.
  @spec begin(Life.t()) :: reference()
  def begin(state),
    do: Process.send_after(self(), {:situ_stuck, mark(state)}, state.settings.stop_timeout)

  @doc "The stop timeout has passed: kills what is stuck, unless something has moved since `mark`."
  @spec stuck(Life.t(), term()) :: Life.t()
  def stuck(%{phase: phase, stop_wish: wish} = state, mark)
      when phase == :stopping or (phase == :starting and wish != nil) do
    if mark(state) == mark, do: kill(state), else: watch_again(state)
  end

  def stuck(state, _mark), do: state

  defp watch_again(state) do
    begin(state)
    state
  end

  defp kill(state) do
    late = late(state)
    names = Enum.map_join(late, ", ", fn stage -> hd(stage.vertices).path end)
    for stage <- late, do: Process.exit(stage.pid, :kill)

    error =
      Error.new(
        :stuck,
        "#{names} did not end within #{state.settings.stop_timeout} ms and was killed",
        why: "it neither took a message nor answered the stop",
        fix:
          "look for a loop or a call that never returns; raise stop_timeout: when it is just slow",
        meta: %{component: names}
      )

    state =
      if Enum.all?(late, &is_map_key(state.taps, &1.id)),
        do: state,
        else: Notice.failed(state, error)

    begin(state)
    state
  end

  # Those that are in the middle of something; only if there are none, those that still owe an answer.
  defp late(state) do
    alive = for {_, stage} <- state.stages, stage.state != :dead, do: stage
    with [] <- Enum.reject(alive, &idle?/1), do: Enum.filter(alive, &owes?(&1, state))
  end

  defp owes?(stage, state) do
    MapSet.member?(state.pending, stage.id) or
      (state.step == :finalize and
         Enum.any?(state.active, fn {_, link} -> link.to == stage.id end))
  end

  @doc "Whether the stage waits for a message and has none."
  @spec idle?(map()) :: boolean()
  def idle?(stage) do
    case Process.info(stage.pid, [:message_queue_len, :current_function]) do
      [message_queue_len: 0, current_function: {:gen_server, _, _}] -> true
      nil -> true
      _ -> false
    end
  end

  @doc "What stays the same as long as nothing moves."
  @spec mark(Life.t()) :: term()
  def mark(state) do
    flows = for {_, ref} <- state.counters, do: Counters.flow(ref)
    waiting = {MapSet.size(state.pending), map_size(state.active)}
    {state.step, waiting, state.moves, :erlang.phash2(flows)}
  end
end
