defmodule Situ.Cluster.Standby do
  @moduledoc false
  # How a node waits for a part that it does not run: the lease as it knows it, when it looks at it next, and how far it
  # stands behind other nodes. The owner tells the other nodes of each beat of its lease (`Situ.Cluster.Member`), so the
  # log is looked at only when two beats are missing, or where nodes have no connection.
  alias Situ.Cluster.{Lease, Losses}

  # Of nodes: so many go before one that was drained.
  @behind 10

  @enforce_keys [:ms]
  defstruct [:ms, :timer, :loan, lease: %Lease{}, losses: %Losses{}, away: 0]

  @typedoc """
  `ms`: the lease's time; `away`: how far behind; `loan`: for as long as a process lives, and what was before.
  """
  @type t :: %__MODULE__{
          ms: pos_integer(),
          timer: reference() | nil,
          loan: {reference(), non_neg_integer()} | nil,
          lease: Lease.t(),
          losses: Losses.t(),
          away: non_neg_integer()
        }

  @spec new(Situ.Time.duration()) :: t()
  def new(lease_ns), do: %__MODULE__{ms: max(div(lease_ns, 1_000_000), 20)}

  @doc "Takes in one look at the lease; `rank`: how many nodes are preferred to this one."
  @spec observe(
          t(),
          {non_neg_integer(), String.t() | nil, integer(), integer()},
          non_neg_integer()
        ) ::
          {:take | :wait, t()}
  def observe(%__MODULE__{ms: ms} = standby, look, rank) do
    # A drained node waits behind the others, for some seconds; it takes a part that nobody else does.
    before = rank + @behind * standby.away
    wait = before * div(ms, 2) + Losses.wait(standby.losses, now(), ms)
    {answer, lease} = Lease.observe(standby.lease, look, %{lease: ms, poll: poll(ms), wait: wait})
    {answer, %{standby | lease: lease}}
  end

  @doc "The owner has written its lease under this number."
  @spec hear(t(), pos_integer(), String.t()) :: t()
  def hear(%__MODULE__{ms: ms} = standby, seq, owner),
    do: look_in(%{standby | lease: Lease.hear(standby.lease, seq, owner, now())}, div(ms, 2))

  @doc "A node was reported down."
  @spec down(t(), node()) :: t()
  def down(%__MODULE__{} = standby, node) do
    standby = %{standby | lease: Lease.down(standby.lease, node)}
    if standby.lease.gone, do: look_in(standby, 0), else: standby
  end

  @doc "This node had the part, and another has it now, or nobody."
  @spec lost(t()) :: t()
  def lost(%__MODULE__{ms: ms} = standby),
    do: look_again(%{standby | lease: %Lease{}, losses: Losses.add(standby.losses, now(), ms)})

  @doc "This node has given the part away."
  @spec released(t()) :: t()
  def released(%__MODULE__{} = standby), do: look_again(%{standby | lease: %Lease{}})

  @doc "Sends this process `:look` in a while. A log that takes its time is asked less often."
  @spec look_again(t()) :: t()
  def look_again(%__MODULE__{ms: ms, lease: lease} = standby),
    do: look_in(standby, max(poll(ms), min(4 * lease.took, ms)))

  @doc "Sends this process `:look` in `ms`, and not before."
  @spec look_in(t(), non_neg_integer()) :: t()
  def look_in(%__MODULE__{timer: timer} = standby, ms) do
    _ = timer && Process.cancel_timer(timer)
    %{standby | timer: Process.send_after(self(), :look, ms)}
  end

  @doc "Stands `away` behind; with a process, for as long as that lives."
  @spec lend(t(), non_neg_integer(), pid() | nil) :: t()
  def lend(%__MODULE__{loan: {ref, before}} = standby, away, mover) do
    Process.demonitor(ref, [:flush])
    lend(%{standby | loan: nil, away: before}, away, mover)
  end

  # It is given the part: what it has lost before is no reason to wait.
  def lend(standby, 0, nil), do: %{standby | away: 0, losses: %Losses{}}
  def lend(standby, away, nil), do: %{standby | away: away}

  def lend(standby, away, mover),
    do: %{standby | loan: {Process.monitor(mover), standby.away}, away: away}

  @doc "A monitored process has gone: was it the one that the loan was for?"
  @spec give_back(t(), reference()) :: t()
  def give_back(%__MODULE__{loan: {ref, before}} = standby, ref),
    do: %{standby | loan: nil, away: before}

  def give_back(standby, _ref), do: standby

  defp poll(ms), do: max(div(ms, 10), 5)
  defp now, do: System.monotonic_time(:millisecond)
end
