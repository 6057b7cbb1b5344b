defmodule Situ.Stage.Disorder do
  @moduledoc false
  # The errors of an output whose messages are out of order.
  alias Situ.Error
  alias Situ.Stage.Outlet

  @spec not_increasing(Outlet.t(), integer()) :: Error.t()
  def not_increasing(outlet, time) do
    Error.new(
      :time_not_increasing,
      "#{outlet.path}.#{outlet.name} emitted at #{time} ns after #{outlet.last_time} ns",
      why: "originating times of one output strictly increase",
      fix:
        "give each message its own, later time (equal ones: on_same_time: :drop or :nudge); in a cycle, delay the message",
      meta: %{
        component: outlet.path,
        output: outlet.name,
        time: time,
        last_time: outlet.last_time
      }
    )
  end

  @spec bad_sequence(Outlet.t(), integer()) :: Error.t()
  def bad_sequence(outlet, id) do
    Error.new(
      :sequence_not_increasing,
      "#{outlet.path}.#{outlet.name} emitted sequence id #{id} after #{outlet.seq}",
      why: "sequence ids of one output strictly increase",
      meta: %{component: outlet.path, output: outlet.name, sequence_id: id, last: outlet.seq}
    )
  end

  @spec bad_creation(Outlet.t(), integer()) :: Error.t()
  def bad_creation(outlet, time) do
    Error.new(
      :creation_time_went_back,
      "#{outlet.path}.#{outlet.name} emitted a message created at #{time} ns after one created at #{outlet.last_creation} ns",
      why: "creation times of one output never decrease",
      meta: %{
        component: outlet.path,
        output: outlet.name,
        time: time,
        last_time: outlet.last_creation
      }
    )
  end
end
