defmodule Situ.Stage.Marks do
  @moduledoc false
  # How far each output of a stage has come, in shared memory: what a process that takes the place of a dead one goes on from.
  alias Situ.Message
  alias Situ.Stage.Outlet

  @type t :: :atomics.atomics_ref()

  @spec new(non_neg_integer()) :: t()
  def new(outputs), do: :atomics.new(max(outputs, 1) * 3, signed: true)

  @doc "`message` is the last one that was sent."
  @spec put({t(), non_neg_integer()} | nil, Message.t()) :: :ok
  def put(nil, _message), do: :ok

  def put({ref, index}, message) do
    :atomics.put(ref, index * 3 + 1, message.originating_time)
    :atomics.put(ref, index * 3 + 2, message.creation_time)
    :atomics.put(ref, index * 3 + 3, message.sequence_id)
  end

  @doc "The outlet that notes how far it comes, begun where it was before."
  @spec attach(Outlet.t(), t() | nil, non_neg_integer()) :: Outlet.t()
  def attach(outlet, nil, _index), do: outlet

  def attach(outlet, ref, index) do
    outlet = %{outlet | mark: {ref, index}}

    case :atomics.get(ref, index * 3 + 3) do
      0 ->
        outlet

      seq ->
        time = :atomics.get(ref, index * 3 + 1)
        creation = :atomics.get(ref, index * 3 + 2)
        Outlet.resume(%{outlet | last_time: time, last_creation: creation, seq: seq})
    end
  end
end
