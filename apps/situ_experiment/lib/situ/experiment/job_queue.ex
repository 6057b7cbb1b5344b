defmodule Situ.Experiment.JobQueue do
  @moduledoc false
  # The trials that wait for a node of a cluster. Trials of a session share its recordings and stages, so a node takes
  # trials of the session that it has begun before those of another one. Pure.

  @enforce_keys [:waiting]
  defstruct [:waiting, begun: %{}]

  @typedoc "`waiting`: the jobs by session, in their order. `begun`: the node that has begun a session."
  @opaque t :: %__MODULE__{waiting: [{session(), [job()]}], begun: %{session() => node()}}
  @type session :: term()
  @type job :: term()

  @doc """
  Builds a queue from `[{session, job}]`.

      iex> alias Situ.Experiment.JobQueue
      iex> queue = JobQueue.new(p1: 1, p1: 2, p2: 3)
      iex> {{:ok, 1}, queue} = JobQueue.take(queue, :a)
      iex> {{:ok, 3}, queue} = JobQueue.take(queue, :b)
      iex> {{:ok, 2}, queue} = JobQueue.take(queue, :b)
      iex> JobQueue.take(queue, :a) == {:empty, queue}
      true
  """
  @spec new([{session(), job()}]) :: t()
  def new(jobs) do
    by_session = Enum.group_by(jobs, &elem(&1, 0), &elem(&1, 1))
    order = jobs |> Enum.map(&elem(&1, 0)) |> Enum.uniq()
    %__MODULE__{waiting: for(session <- order, do: {session, by_session[session]})}
  end

  @doc """
  Takes the next job for a node: of a session that it has begun, of a session that no node has begun, or of the session
  with the most waiting jobs.
  """
  @spec take(t(), node()) :: {{:ok, job()} | :empty, t()}
  def take(%__MODULE__{waiting: []} = queue, _node), do: {:empty, queue}

  def take(%__MODULE__{} = queue, node) do
    session = choose_session(queue, node)
    {^session, [job | rest]} = List.keyfind!(queue.waiting, session, 0)

    waiting =
      if rest == [],
        do: List.keydelete(queue.waiting, session, 0),
        else: List.keyreplace(queue.waiting, session, 0, {session, rest})

    {{:ok, job}, %{queue | waiting: waiting, begun: Map.put(queue.begun, session, node)}}
  end

  defp choose_session(%{waiting: waiting, begun: begun}, node) do
    sessions = for {session, _} <- waiting, do: session

    Enum.find(sessions, &(begun[&1] == node)) ||
      Enum.find(sessions, &(not is_map_key(begun, &1))) ||
      waiting |> Enum.max_by(fn {_, jobs} -> length(jobs) end) |> elem(0)
  end

  @doc "Puts a job back whose node was lost. It is the next one of its session."
  @spec put_back(t(), session(), job()) :: t()
  def put_back(%__MODULE__{waiting: waiting} = queue, session, job) do
    case List.keyfind(waiting, session, 0) do
      nil ->
        %{queue | waiting: [{session, [job]} | waiting]}

      {_, jobs} ->
        %{queue | waiting: List.keyreplace(waiting, session, 0, {session, [job | jobs]})}
    end
  end

  @doc "Makes the sessions of a lost node free for other nodes."
  @spec forget_node(t(), node()) :: t()
  def forget_node(%__MODULE__{begun: begun} = queue, node),
    do: %{queue | begun: Map.reject(begun, fn {_, other} -> other == node end)}
end
