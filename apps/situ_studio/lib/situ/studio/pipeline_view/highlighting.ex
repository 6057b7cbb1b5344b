defmodule Situ.Studio.PipelineView.Highlighting do
  @moduledoc false
  # Decides which connections are highlighted in a pipeline's graph: connections with one delivery
  # policy, or connections whose producer waits. All others are faded. Pure.

  # The keys are the names that `Situ.Delivery.display_name/1` returns.
  @choices [
    {"none", "nothing"},
    {"unlimited", "unlimited"},
    {"latest", "latest message"},
    {"throttle", "throttle"},
    {"synchronous", "synchronous or throttle"},
    {"max_latency", "latency constrained"},
    {"max_queue", "queue size constrained"},
    {"waits", "producer waits"}
  ]
  @directions [
    {"LR", "left to right"},
    {"TB", "top to bottom"},
    {"RL", "right to left"},
    {"BT", "bottom to top"}
  ]

  @doc "Lists the ways to highlight connections, with their display names."
  @spec highlight_choices() :: [{String.t(), String.t()}]
  def highlight_choices, do: @choices

  @doc "Lists the directions in which the graph can be laid out."
  @spec graph_directions() :: [{String.t(), String.t()}]
  def graph_directions, do: @directions

  @doc """
  Returns whether a connection is faded. A line that represents several connections has all their policies.

      iex> alias Situ.Studio.PipelineView.Highlighting
      iex> for mark <- ["none", "throttle", "latest", "waits"], do: Highlighting.faded?(mark, "throttle(8)", true)
      [false, false, true, false]
  """
  @spec faded?(String.t(), String.t() | nil, boolean()) :: boolean()
  def faded?("none", _policy, _waits?), do: false
  def faded?("waits", _policy, waits?), do: not waits?

  def faded?("synchronous", policy, waits?),
    do: policy not in ["synchronous"] and faded?("throttle", policy, waits?)

  def faded?(mark, policy, _waits?) do
    (policy || "")
    |> String.split(", ")
    |> Enum.all?(&(&1 != mark and not String.starts_with?(&1, mark <> "(")))
  end
end
