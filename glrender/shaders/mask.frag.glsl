layout(location = 0) out float irradiance;

void main() { irradiance = 0.0; }
