defmodule LobbyRobot.Greeter do
  @moduledoc """
  Decides whom to greet, and when. The input contains, for every image and person, whether the person looks at the
  robot. A person is greeted after looking for `patience`, and again only after an absence of `absence`.
  """
  use Situ.Component,
    inputs: [in: {:map, :any, :boolean}],
    outputs: [out: :string],
    options: [
      patience: [
        type: :time_ns,
        default: 800_000_000,
        doc: "The time before the greeting, in ns."
      ],
      absence: [
        type: :time_ns,
        default: 30_000_000_000,
        doc: "The time between two visits, in ns."
      ]
    ]

  # The longest time for which a person may look away, or is not recognised, in between.
  @glance Situ.Time.ms(400)

  @impl true
  def init(opts),
    do: {:ok, %{patience: opts[:patience], absence: opts[:absence], people: %{}, count: 0}}

  @impl true
  def handle_message(:in, %{data: looks, originating_time: time}, _context, state) do
    looking = for {id, true} <- looks, do: id
    present = Map.reject(state.people, fn {_id, person} -> time - person.seen > state.absence end)

    people =
      Enum.reduce(looking, present, &Map.update(&2, &1, arrival(time), fn p -> see(p, time) end))

    ready = for id <- looking, person = people[id], ready?(person, time, state.patience), do: id
    people = Enum.reduce(ready, people, &put_in(&2, [&1, :greeted?], true))
    state = %{state | people: people}

    if ready == [],
      do: {[], state},
      else: {[{:out, time, greeting(state.count)}], %{state | count: state.count + length(ready)}}
  end

  defp arrival(time), do: %{since: time, seen: time, greeted?: false}

  defp see(%{seen: seen} = person, time) when time - seen > @glance,
    do: %{person | since: time, seen: time}

  defp see(person, time), do: %{person | seen: time}

  defp ready?(person, time, patience), do: not person.greeted? and time - person.since >= patience

  defp greeting(0), do: "Hello! I am the robot of this lobby. How can I help you?"
  defp greeting(_), do: "Hello to you, too!"
end
