defmodule Situ.Infer.Samples do
  @moduledoc false
  # Checks audio for networks: it must have complete frames of finite samples. A single NaN would turn a recurrent
  # network's whole state into NaN permanently.
  alias Situ.{AudioBuffer, Error}

  @spec check(AudioBuffer.t()) :: :ok | {:error, Error.t()}
  def check(%AudioBuffer{} = buffer) do
    case AudioBuffer.validate(buffer) do
      {:ok, %{format: %{sample: :f32}, data: data}} -> numbers(data, 0)
      {:ok, %{format: %{sample: :f64}, data: data}} -> numbers64(data, 0)
      {:ok, _} -> :ok
      {:error, error} -> {:error, %{error | fix: error.fix || "check the source of the audio"}}
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
     Error.new(:bad_audio, "invalid audio: sample #{i} is not a number (NaN or infinite)",
       why: "an earlier component divided by zero or overflowed",
       fix: "check the source of the audio; Situ.map can replace such buffers with silence"
     )}
  end
end
