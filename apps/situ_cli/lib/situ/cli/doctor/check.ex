defmodule Situ.CLI.Doctor.Check do
  @moduledoc false
  # The result of one check of `situ doctor`.
  @enforce_keys [:group, :name, :status, :purpose]
  defstruct [:group, :name, :status, :purpose, :found, :fix, required?: false]

  @type t :: %__MODULE__{
          group: String.t(),
          name: String.t(),
          status: :ok | :missing,
          purpose: String.t(),
          found: String.t() | nil,
          fix: String.t() | nil,
          required?: boolean()
        }

  @doc "Returns whether most programs fail without it."
  @spec required_and_missing?(t()) :: boolean()
  def required_and_missing?(%__MODULE__{} = check),
    do: check.required? and check.status == :missing

  @doc """
  Formats the check as lines of text.

      iex> check = %Situ.CLI.Doctor.Check{
      ...>   group: "Programs", name: "ffmpeg", status: :missing, purpose: "video files", fix: "bin/setup"
      ...> }
      iex> Situ.CLI.Doctor.Check.format_lines(check)
      ["missing  ffmpeg: video files", "         Fix: bin/setup"]
      iex> Situ.CLI.Doctor.Check.format_lines(%{check | status: :ok, found: "5.1"})
      ["ok       ffmpeg 5.1: video files"]
  """
  @spec format_lines(t()) :: [String.t()]
  def format_lines(%__MODULE__{status: :ok} = check),
    do: ["ok       #{Enum.join([check.name | List.wrap(check.found)], " ")}: #{check.purpose}"]

  def format_lines(%__MODULE__{status: :missing} = check),
    do: ["missing  #{check.name}: #{check.purpose}", "         Fix: #{check.fix}"]
end
