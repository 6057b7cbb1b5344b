defmodule Situ.Delivery do
  @moduledoc """
  Delivery policies decide how an input's queue behaves when messages arrive faster than they are consumed.

  | policy | loses messages | what happens under load |
  |---|---|---|
  | `unlimited/1` (default) | never | the producer waits once a window of 1,000 messages is in flight |
  | `throttle/2` | never | the same with a window of `n` messages (default 128) |
  | `synchronous/1` | never | light operators run inside the producer's process; other consumers are throttled |
  | `latest/1` | yes | only the newest waiting message is kept |
  | `max_queue/2` | yes | the `n` newest waiting messages are kept; `throttle: true` pauses sources that can wait |
  | `max_latency/2` | yes | messages older than `d` when they would be consumed are dropped |

  Every policy takes `guarantee: fn data -> boolean end`. Messages for which the function returns `true` are never
  dropped. `with_guarantee/2` adds further guarantees. A push source (a camera) cannot wait, so its output buffer
  grows if the input is lossless. A dropping policy keeps its queue at the producer, so a slow consumer never holds
  more than the size of the queue.

  If the process of a consumer with `on_error: :restart` dies, a lossless policy delivers the messages again that
  it had not handled. The restarted consumer emits nothing twice: it does not repeat messages up to its last one. With
  `on_restart: :drop`, these messages are lost and count as dropped.

      iex> policy = Situ.Delivery.max_queue(3, guarantee: &is_atom/1)
      iex> {Situ.Delivery.lossy?(policy), policy.max_queue}
      {true, 3}
  """
  alias Situ.{Error, Options}

  @window 1_000
  @small_window 128
  @enforce_keys [:kind]
  defstruct [
    :kind,
    :guarantee,
    max_queue: :infinity,
    max_latency: :infinity,
    window: @window,
    throttle: false,
    on_restart: :redeliver
  ]

  @type kind :: :unlimited | :latest | :max_queue | :max_latency | :throttle | :synchronous
  @type t :: %__MODULE__{
          kind: kind(),
          guarantee: (term() -> boolean()) | nil,
          max_queue: pos_integer() | :infinity,
          max_latency: Situ.Time.duration() | :infinity,
          window: pos_integer() | :infinity,
          throttle: boolean(),
          on_restart: :redeliver | :drop
        }

  @schema [
    guarantee: [type: {:fun, 1}, doc: "Data for which this returns `true` is never dropped."],
    window: [
      type: {:or, [:pos_integer, {:in, [:infinity]}]},
      default: @window,
      doc: "Messages in flight before the producer waits; with `:infinity` it never waits."
    ],
    on_restart: [
      type: {:in, [:redeliver, :drop]},
      default: :redeliver,
      doc:
        "The treatment of messages that a consumer had received, but not handled, when its process died and is " <>
          "restarted. A policy that loses messages always drops them."
    ]
  ]

  @doc "Returns a lossless policy with back-pressure after `window:` (default 1,000) messages in flight."
  @spec unlimited(keyword()) :: t()
  def unlimited(opts \\ []), do: build_policy(:unlimited, [], opts)

  @doc "Keeps only the newest waiting message."
  @spec latest(keyword()) :: t()
  def latest(opts \\ []), do: build_policy(:latest, [max_queue: 1], opts)

  @doc """
  Keeps the `n` newest waiting messages.

  With `throttle: true`, a full queue stops the producers that can wait (files, generators, and operators downstream
  of them) and drops only the messages of sources that cannot wait (cameras, timers).
  """
  @spec max_queue(pos_integer(), keyword()) :: t()
  def max_queue(n, opts \\ []) when is_integer(n) and n > 0 do
    {throttle, opts} = Keyword.pop(opts, :throttle, false)

    if not is_boolean(throttle),
      do: raise(ArgumentError, "throttle: is true or false, got: #{inspect(throttle)}")

    build_policy(:max_queue, [max_queue: n, throttle: throttle], opts)
  end

  @doc "Drops a message whose age (clock - originating time) is more than `d` ns when the consumer would take it."
  @spec max_latency(Situ.Time.duration(), keyword()) :: t()
  def max_latency(d, opts \\ []) when is_integer(d) and d >= 0,
    do: build_policy(:max_latency, [max_latency: d], opts)

  @doc """
  Returns a lossless policy: the producer waits as soon as `n` messages are waiting for the consumer, in addition to
  the message being handled.

  Light operators that share a process take turns, so nothing has to be limited between them: a few hundred messages
  can wait there. The limit applies between processes (other components, `async: true`, and operators that are so slow
  that they get their own process). `throttle(1)` is expensive there: two messages cost two wake-ups, about 5 us. The
  default of 128 keeps few messages in flight at nearly the cost of `unlimited/1`.
  """
  @spec throttle(pos_integer(), keyword()) :: t()
  def throttle(n \\ @small_window, opts \\ []) when is_integer(n) and n > 0,
    do: build_policy(:throttle, [], Keyword.put(opts, :window, n))

  @doc """
  Returns a lossless policy: a light operator runs in its producer's process, without a queue. Any other consumer is
  throttled as with `throttle/2`.
  """
  @spec synchronous(keyword()) :: t()
  def synchronous(opts \\ []),
    do: build_policy(:synchronous, [], Keyword.put_new(opts, :window, @small_window))

  @doc "Adds a guarantee. Data is kept if either predicate returns `true`."
  @spec with_guarantee(t(), (term() -> boolean())) :: t()
  def with_guarantee(%__MODULE__{guarantee: nil} = policy, keep?) when is_function(keep?, 1),
    do: %{policy | guarantee: keep?}

  def with_guarantee(%__MODULE__{guarantee: before?} = policy, keep?) when is_function(keep?, 1),
    do: %{policy | guarantee: fn data -> before?.(data) or keep?.(data) end}

  @doc """
  Parses a policy name, for configuration files and command lines.

      iex> {:ok, policy} = Situ.Delivery.parse("max_queue(5)")
      iex> policy.max_queue
      5
      iex> {:error, error} = Situ.Delivery.parse("lastest")
      iex> error.fix
      "did you mean \\"latest\\"?"
  """
  @spec parse(String.t()) :: {:ok, t()} | {:error, Error.t()}
  def parse("unlimited"), do: {:ok, unlimited()}
  def parse("latest"), do: {:ok, latest()}
  def parse("throttle"), do: {:ok, throttle()}
  def parse(name) when name in ["synchronous", "sync"], do: {:ok, synchronous()}

  def parse(text) when is_binary(text) do
    case Regex.run(~r/^(max_queue|max_latency|throttle)\(([1-9][0-9]{0,17})\)$/, text) do
      [_, "max_queue", n] -> {:ok, max_queue(String.to_integer(n))}
      [_, "max_latency", n] -> {:ok, max_latency(String.to_integer(n))}
      [_, "throttle", n] -> {:ok, throttle(String.to_integer(n))}
      nil -> {:error, unknown_policy_error(text)}
    end
  end

  @calls %{
    "unlimited" => "unlimited()",
    "latest" => "latest()",
    "throttle" => "throttle()",
    "synchronous" => "synchronous()",
    "max_queue" => "max_queue(5)",
    "max_latency" => "max_latency(Situ.Time.ms(100))"
  }

  @doc """
  Returns a hint with the call to write instead of a value that is not a policy, or `nil`.

      iex> Situ.Delivery.suggest(:lastest)
      "did you mean Situ.Delivery.latest()?"
  """
  @spec suggest(term()) :: String.t() | nil
  def suggest({name, _limit}), do: suggest(name)

  def suggest(name)
      when is_binary(name) or (is_atom(name) and name not in [nil, true, false]) do
    case Options.nearest_name(name, Map.keys(@calls)) do
      nil -> "policies are: " <> Enum.map_join(Map.values(@calls), ", ", &"Situ.Delivery.#{&1}")
      near -> "did you mean Situ.Delivery.#{@calls[near]}?"
    end
  end

  def suggest(_other), do: nil

  @doc "Returns whether the policy may drop messages."
  @spec lossy?(t()) :: boolean()
  def lossy?(%__MODULE__{max_queue: :infinity, max_latency: :infinity}), do: false
  def lossy?(%__MODULE__{}), do: true

  @doc "Returns a short name of the policy, for diagnostics."
  @spec display_name(t()) :: String.t()
  def display_name(%__MODULE__{kind: :max_queue, max_queue: n}), do: "max_queue(#{n})"
  def display_name(%__MODULE__{kind: :throttle, window: n}), do: "throttle(#{n})"

  def display_name(%__MODULE__{kind: :max_latency, max_latency: d}),
    do: "max_latency(#{Situ.Time.format_duration(d)})"

  def display_name(%__MODULE__{kind: kind}), do: Atom.to_string(kind)

  defp build_policy(kind, limits, opts) do
    struct!(%__MODULE__{kind: kind}, limits ++ Options.validate!(opts, @schema))
  end

  defp unknown_policy_error(text) do
    names = ~w[unlimited latest throttle synchronous max_queue(5) max_latency(1000000)]
    near = Options.nearest_name(text, names)
    fix = if near, do: "did you mean #{inspect(near)}?", else: "known: " <> Enum.join(names, ", ")
    Error.new(:unknown_policy, "unknown delivery policy #{inspect(text)}", fix: fix)
  end
end
