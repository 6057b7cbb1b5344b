defmodule Situ.Infer.Samples do
  @moduledoc false
  # Sound that networks can hear: whole frames, and every sample a number. One that is none would make all that a
  # network remembers none, for ever.
  alias Situ.{AudioBuffer, Error}

  @spec check(AudioBuffer.t()) :: :ok | {:error, Error.t()}
  def check(%AudioBuffer{} = buffer) do
    case AudioBuffer.validate(buffer) do
      {:ok, %{format: %{sample: :f32}, data: data}} -> numbers(data, 0)
      {:ok, %{format: %{sample: :f64}, data: data}} -> numbers64(data, 0)
      {:ok, _} -> :ok
      {:error, error} -> {:error, %{error | fix: error.fix || "look at what makes the sound"}}
    end
  end

  defp numbers(<<_::float-native-32, rest::binary>>, i), do: numbers(rest, i + 1)
  defp numbers(<<>>, _i), do: :ok
  defp numbers(_, i), do: none(i)

  defp numbers64(<<_::float-native-64, rest::binary>>, i), do: numbers64(rest, i + 1)
  defp numbers64(<<>>, _i), do: :ok
  defp numbers64(_, i), do: none(i)

  defp none(i) do
    {:error,
     Error.new(:bad_audio, "the sound is no sound: sample #{i} is not a number (NaN or infinite)",
       why: "something before it divided by zero or overflowed",
       fix: "look at what makes the sound; Situ.map can put silence in its place"
     )}
  end
end
