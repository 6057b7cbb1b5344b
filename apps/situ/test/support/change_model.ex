defmodule Situ.Fixture.ChangeModel do
  # Predicts the messages of a pipeline that is changed at random. The operators number the messages that they have
  # handled and hash them, so that a lost, repeated or foreign message shows in every later one. Pure.

  @type operator_state :: {number :: integer(), handled :: non_neg_integer(), hash :: integer()}

  @doc "Returns the state of an operator that has not handled a message."
  def new_state, do: {-1, 0, 0}

  @doc "Handles message `i`."
  def step(i, {_last, n, hash}), do: {i, n + 1, :erlang.phash2({hash, i})}

  @doc "Handles message `i`, or raises."
  def raise_or_step(i, state), do: i |> raise_at() |> step(state)

  @doc "Returns the message unless it is one at which operators raise."
  def raise_at(i), do: if(raises?(i), do: raise("message #{i}"), else: i)

  defp raises?(i), do: rem(i, 25) == 11

  @doc """
  Compares the values at the sinks, `{process, value}` by name in order, with the first `count` messages and with the
  results of the changes, `{kind, name, result}`.
  """
  def find_problems(seen, changes, count) do
    values = Map.new(seen, fn {name, entries} -> {name, Enum.map(entries, &elem(&1, 1))} end)

    main =
      for {name, expected} <- main_streams(count),
          Map.get(values, name, []) != expected,
          do: {name, expected: expected, seen: values[name]}

    gain =
      for {{i, n, k}, at} <- Enum.with_index(values[:s1] || []),
          i != at or n != at or k < 1,
          do: i

    gain =
      if gain == [] and length(values[:s1] || []) == count, do: [], else: [{:s1, values[:s1]}]

    taps = for {{:tap, _} = name, values} <- values, not contiguous?(values), do: {name, values}
    cuts = for {:checkpoint, _, {:ok, [n, m]}} <- changes, n != m, do: {:checkpoint, n, m}

    parts =
      for {name, entries} when is_binary(name) <- seen,
          part = find_part_problem(name, entries, changes),
          do: part

    victim = find_victim_problem(seen[:victim] || [], changes)
    main ++ gain ++ taps ++ cuts ++ parts ++ List.wrap(victim)
  end

  defp main_streams(count) do
    numbers = Enum.to_list(0..(count - 1)//1)
    states = Enum.scan(numbers, new_state(), &step/2)

    {restarts, _} =
      Enum.flat_map_reduce(numbers, new_state(), fn i, state ->
        if raises?(i), do: {[], new_state()}, else: {[step(i, state)], step(i, state)}
      end)

    [
      s0: numbers,
      s2: states,
      s3: Enum.zip(numbers, states),
      skips: Enum.reject(numbers, &raises?/1),
      restarts: restarts,
      slow: numbers
    ]
  end

  defp contiguous?([]), do: true

  defp contiguous?([first | _] = values),
    do: values == Enum.to_list(first..(first + length(values) - 1))

  # A process of a part sees a contiguous piece of the stream. The next process begins afresh, or continues with the
  # state of a checkpoint.
  defp find_part_problem(name, entries, changes) do
    fresh = count(changes, name, [:extend, :kill]) + count(changes, name, [{:start, :fresh}])
    continued = count(changes, name, [{:start, :checkpoint}])
    limits = %{fresh: fresh, continued: continued}

    {_last, turns, problems} =
      Enum.reduce(
        entries,
        {nil, %{fresh: 0, continued: 0}, []},
        &check_entry(&1, &2, name == "Own")
      )

    too_many = for {kind, n} <- turns, n > limits[kind], do: {kind, n, limits[kind]}
    if problems ++ too_many != [], do: {name, problems ++ too_many, entries: entries}
  end

  defp check_entry({_process, {i, _n, _hash} = state} = entry, {last, turns, problems}, own?) do
    case judge(entry, last, own?) do
      :same ->
        {entry, turns, problems}

      kind when kind in [:fresh, :continued] ->
        {entry, Map.update!(turns, kind, &(&1 + 1)), problems}

      :wrong ->
        {entry, turns, [{i, state, last} | problems]}
    end
  end

  defp judge({process, {i, _, _} = state}, {process, {last, _, _} = before}, _own_source?),
    do: if(i == last + 1 and state == step(i, before), do: :same, else: :wrong)

  # A part with its own source begins again at zero when it is added again; if it is then killed, the first messages are
  # lost.
  defp judge({_process, {i, _, _} = state}, before, own_source?) do
    cond do
      before != nil and i <= elem(elem(before, 1), 0) and not own_source? ->
        :wrong

      state == step(i, new_state()) ->
        :fresh

      before != nil and state == step(i, elem(before, 1)) and not skips?(i, before, own_source?) ->
        :continued

      true ->
        :wrong
    end
  end

  # A source that continues skips nothing.
  defp skips?(i, {_process, {last, _, _}}, own_source?), do: own_source? and i != last + 1

  # An operator that is killed loses nothing. It restarts with a fresh state and handles the messages again that it had
  # not acknowledged, but emits nothing again that it had emitted of them.
  defp find_victim_problem(entries, changes) do
    {_last, resets, problems} =
      Enum.reduce(entries, {new_state(), 0, []}, fn {_, {i, _, _} = state},
                                                    {{last, _, _} = before, resets, problems} ->
        cond do
          i == last + 1 and state == step(i, before) -> {state, resets, problems}
          i == last + 1 and restarted?(state) -> {state, resets + 1, problems}
          true -> {state, resets, [{i, state, before} | problems]}
        end
      end)

    too_many? = resets > count(changes, "Victim", [:kill])
    if problems != [] or too_many?, do: {:victim, resets, problems, entries: entries}
  end

  defp restarted?({i, n, _hash} = state),
    do: n <= i + 1 and state == Enum.reduce((i - n + 1)..i, new_state(), &step/2)

  # A change that was refused has no effect.
  defp count(changes, name, kinds),
    do:
      Enum.count(changes, fn {kind, at, result} ->
        kind in kinds and at == name and not match?({:error, _}, result)
      end)
end
