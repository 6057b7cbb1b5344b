defmodule Situ.Media.NativeKernel do
  @moduledoc false
  # Runs native kernels: chooses the scheduler by the expected work and converts failures to Situ.Error.
  #
  # Below the limit, a kernel runs on the calling scheduler and its time is charged to the process. Above the limit it
  # runs on a dirty scheduler, whose switch costs 10 to 20 us on an idle machine and milliseconds on a busy one.
  # See docs/adr/0040-native-kernels-are-jobs.md.

  alias Situ.Error
  alias Situ.Media.{Native, OpenCV}

  @inline_limit_us 250

  @doc "Runs an image kernel that takes about `us` microseconds."
  @spec run_image(tuple(), number()) :: {:ok, term()} | {:error, Error.t()}
  def run_image(job, us) do
    wrap_result(if(us < @inline_limit_us, do: Native.run(job), else: Native.run_dirty(job)), job)
  rescue
    error in [ArgumentError, ErlangError] -> argument_error!(error, job, __STACKTRACE__)
  end

  @doc "Runs an audio kernel that takes about `us` microseconds."
  @spec run_audio(tuple(), number()) :: {:ok, term()} | {:error, Error.t()}
  def run_audio(job, us) do
    wrap_result(
      if(us < @inline_limit_us, do: Native.run_sound(job), else: Native.run_sound_dirty(job)),
      job
    )
  rescue
    error in [ArgumentError, ErlangError] -> argument_error!(error, job, __STACKTRACE__)
  end

  @doc "Runs an OpenCV kernel that takes about `us` microseconds."
  @spec run_opencv(tuple(), number()) :: {:ok, term()} | {:error, Error.t()}
  def run_opencv(job, us) do
    wrap_result(if(us < @inline_limit_us, do: OpenCV.run(job), else: OpenCV.run_dirty(job)), job)
  rescue
    error in [ArgumentError, ErlangError] ->
      if match?(%{original: :not_loaded}, error),
        do: {:error, opencv_missing(job)},
        else: argument_error!(error, job, __STACKTRACE__)
  end

  defp wrap_result({:ok, value}, _job), do: {:ok, value}

  defp wrap_result({:error, code, what}, job) do
    {:error, Error.new(code, "#{elem(job, 0)}: #{what}")}
  end

  # Converts errors of arguments that the native side could not decode, such as a number too large for its type, or a
  # list instead of a number.
  defp argument_error!(%ArgumentError{}, job, _trace), do: {:error, bad_argument(job)}

  defp argument_error!(%ErlangError{original: "Could not decode field" <> _}, job, _trace),
    do: {:error, bad_argument(job)}

  defp argument_error!(error, _job, trace), do: reraise(error, trace)

  defp bad_argument(job) do
    Error.new(:bad_option, "#{elem(job, 0)}: an argument has an invalid type or is out of range",
      fix: "see the function's documentation for its arguments"
    )
  end

  defp opencv_missing(job) do
    Error.new(:opencv_missing, "#{elem(job, 0)}: OpenCV's library could not be loaded",
      fix: "install libopencv-imgproc-dev (Debian, Ubuntu) and compile again"
    )
  end
end
