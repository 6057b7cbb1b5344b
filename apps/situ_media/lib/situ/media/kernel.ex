defmodule Situ.Media.Kernel do
  @moduledoc false
  # The door to the native kernels: chooses the scheduler by the work expected and turns failures into Situ.Error.
  #
  # Below the limit a kernel runs where it is called and its time is charged to the process; above, on a dirty
  # scheduler, whose hop costs 10 to 20 us when the machine is idle and milliseconds when it is not.

  alias Situ.Error
  alias Situ.Media.{Native, OpenCV}

  @inline_limit_us 250

  @doc "A picture kernel of about `us` microseconds."
  @spec picture(tuple(), number()) :: {:ok, term()} | {:error, Error.t()}
  def picture(job, us) do
    result(if(us < @inline_limit_us, do: Native.run(job), else: Native.run_dirty(job)), job)
  rescue
    error in [ArgumentError, ErlangError] -> refused!(error, job, __STACKTRACE__)
  end

  @doc "A sound kernel of about `us` microseconds."
  @spec sound(tuple(), number()) :: {:ok, term()} | {:error, Error.t()}
  def sound(job, us) do
    result(
      if(us < @inline_limit_us, do: Native.run_sound(job), else: Native.run_sound_dirty(job)),
      job
    )
  rescue
    error in [ArgumentError, ErlangError] -> refused!(error, job, __STACKTRACE__)
  end

  @doc "An OpenCV kernel of about `us` microseconds."
  @spec opencv(tuple(), number()) :: {:ok, term()} | {:error, Error.t()}
  def opencv(job, us) do
    result(if(us < @inline_limit_us, do: OpenCV.run(job), else: OpenCV.run_dirty(job)), job)
  rescue
    error in [ArgumentError, ErlangError] ->
      if match?(%{original: :not_loaded}, error),
        do: {:error, opencv_missing(job)},
        else: refused!(error, job, __STACKTRACE__)
  end

  defp result({:ok, value}, _job), do: {:ok, value}

  defp result({:error, code, what}, job) do
    {:error, Error.new(code, "#{elem(job, 0)}: #{what}")}
  end

  # Arguments that the native side could not even read: a number too large for its type, a list where a number belongs.
  defp refused!(%ArgumentError{}, job, _trace), do: {:error, refused(job)}

  defp refused!(%ErlangError{original: "Could not decode field" <> _}, job, _trace),
    do: {:error, refused(job)}

  defp refused!(error, _job, trace), do: reraise(error, trace)

  defp refused(job) do
    Error.new(:bad_option, "#{elem(job, 0)}: an argument has a wrong type or is out of range",
      fix: "see the function's documentation for what it takes"
    )
  end

  defp opencv_missing(job) do
    Error.new(:opencv_missing, "#{elem(job, 0)}: OpenCV's library could not be loaded",
      fix: "install libopencv-imgproc-dev (Debian, Ubuntu) and compile again"
    )
  end
end
